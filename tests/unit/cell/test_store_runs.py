"""Run folders: what a run leaves on disk, and what is found after a kill."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError, error
from cell.store.runs import RunFolder, highest_run_id, interrupted_runs, list_runs, load_run


def make(runs: Path, run_id: int, wall: float = 1_700_000_000.0) -> RunFolder:
    info = {"config": {"a": 1}, "identities": {"arm": "9999"}}
    return RunFolder.create(runs, "cone-capture", run_id, info, MonotonicClock(), lambda: wall)


@pytest.fixture
def subject(tmp_path: Path) -> RunFolder:
    return make(tmp_path / "runs", 7)


def test_a_run_folder_is_named_by_time_job_and_number(subject: RunFolder) -> None:
    assert subject.path.name == "20231114T221320Z_cone-capture_7"
    info = json.loads((subject.path / "run.json").read_text())
    assert info["schema"] == "cellward.run/1"
    assert (info["run_id"], info["config"]) == (7, {"a": 1})
    subject.close()


def test_end_json_comes_last_and_makes_the_run_ended(subject: RunFolder) -> None:
    runs = subject.path.parent
    assert [run.run_id for run in interrupted_runs(runs)] == [7]
    subject.note("state", terminal=True, outcome="complete")
    subject.write_result({"schema": "cellward.result/1", "verdict": "pass"})
    subject.finish({"outcome": "complete"})
    assert interrupted_runs(runs) == []
    again = load_run(runs, 7)
    assert again.info["identities"] == {"arm": "9999"}
    end, result = again.read_end(), again.read_result()
    assert end is not None
    assert (end["schema"], end["outcome"]) == ("cellward.end/1", "complete")
    assert result is not None
    assert result["verdict"] == "pass"


def test_a_result_that_cannot_be_read_costs_its_verdict_and_not_the_end(
    subject: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    subject.write_result({"schema": "cellward.result/1", "verdict": "pass"})

    def unreadable(path: Path) -> str:
        raise error("FILE_UNREADABLE", f"{path}: Input/output error")

    with monkeypatch.context() as broken:
        broken.setattr("cell.store.runs.sum_of", unreadable)
        subject.finish({"outcome": "complete", "verdict": "pass"})
        end = subject.read_end()
    assert end is not None
    assert "result_sha256" not in end
    assert "no sum of the result" in [line.get("event") for line in subject.read_journal()]

    (subject.path / "end.json").write_text(json.dumps({**end, "result_sha256": "0"}))
    assert (subject.read_end() or {})["verdict"] == "altered"
    monkeypatch.setattr("cell.store.runs.sum_of", unreadable)
    assert (subject.read_end() or {}) == {**end, "result_sha256": "0", "verdict": None, "figure": None}


def test_an_interrupted_run_gets_one_terminal_line_that_names_the_error(subject: RunFolder) -> None:
    subject.note("state", state="CAPTURE")
    subject.close()
    found = interrupted_runs(subject.path.parent)[0]
    end = found.mark_interrupted()
    assert (end["outcome"], end["error"]["name"]) == ("interrupted", "RUN_INTERRUPTED")
    terminal = [line for line in found.read_journal() if line.get("terminal")]
    assert len(terminal) == 1
    assert interrupted_runs(subject.path.parent) == []


def test_a_terminal_line_without_end_json_is_taken_as_the_end(subject: RunFolder) -> None:
    subject.note("state", terminal=True, outcome="aborted", error={"name": "DEVICE_LOST"})
    subject.close()
    found = interrupted_runs(subject.path.parent)[0]
    assert found.mark_interrupted() == {"outcome": "aborted", "error": {"name": "DEVICE_LOST"}}
    assert len([line for line in found.read_journal() if line.get("terminal")]) == 1
    end = found.read_end()
    assert end is not None
    assert end["outcome"] == "aborted"


def test_runs_are_listed_in_order_and_strangers_are_passed_over(tmp_path: Path) -> None:
    for run_id, wall in ((3, 3e8), (1, 1e8), (2, 2e8), (4, 1.5e8)):  # the clock was set back before the last
        make(tmp_path, run_id, wall).close()
    (tmp_path / "notes").mkdir()
    (tmp_path / "20231114T221320Z_x_9").write_text("a file, not a folder")
    assert [run.run_id for run in list_runs(tmp_path)] == [1, 2, 3, 4]
    assert [run.run_id for run in list_runs(tmp_path, 2)] == [3, 4]
    assert list_runs(tmp_path / "absent") == []
    assert highest_run_id(tmp_path) == 9
    assert highest_run_id(tmp_path / "absent") == 0


def test_a_run_with_a_broken_run_json_is_listed_and_says_why(subject: RunFolder) -> None:
    subject.close()
    (subject.path / "run.json").write_text("{")
    assert "not JSON" in list_runs(subject.path.parent)[0].info["unreadable"]
    with pytest.raises(CellError) as caught:
        load_run(subject.path.parent, 7)
    assert caught.value.name == "FILE_UNREADABLE"


@pytest.mark.parametrize(
    ("file", "field", "value", "wanted"),
    [
        ("run.json", "started", ["a"], "text"),
        ("run.json", "started", "yesterday", "a date and time"),
        ("run.json", "parameters", 5, "an object"),
        ("end.json", "outcome", None, "text"),
        ("end.json", "outcome", 5, "text"),
        ("end.json", "ended", "then", "a date and time"),
        ("end.json", "verdict", {}, "text"),
        ("end.json", "error", ["a"], "an object"),
    ],
)
def test_a_field_of_another_type_is_named_with_its_file(
    subject: RunFolder, file: str, field: str, value: object, wanted: str
) -> None:
    subject.finish({"outcome": "complete", "verdict": "pass", "error": None})
    path = subject.path / file
    path.write_text(json.dumps(json.loads(path.read_text()) | {field: value}))
    with pytest.raises(CellError) as caught:
        load_run(subject.path.parent, 7).read_end()
    assert (caught.value.name, caught.value.detail) == (
        "FILE_UNREADABLE",
        f"{path}: '{field}' should be {wanted}",
    )


def test_a_terminal_line_that_is_none_is_not_taken_as_the_end(subject: RunFolder) -> None:
    subject.note("state", terminal=True, outcome=5)
    subject.close()
    assert interrupted_runs(subject.path.parent)[0].mark_interrupted()["outcome"] == "interrupted"


def test_a_run_that_is_not_there_is_not_found(subject: RunFolder) -> None:
    subject.close()
    with pytest.raises(CellError) as caught:
        load_run(subject.path.parent, 70)
    assert caught.value.name == "NOT_FOUND"


@pytest.mark.parametrize(("job", "run_id"), [("../evil", 1), ("Job", 1), ("a", 0), ("a", 2**32)])
def test_a_name_that_would_leave_the_folder_is_refused(tmp_path: Path, job: str, run_id: int) -> None:
    with pytest.raises(CellError) as caught:
        RunFolder.create(tmp_path, job, run_id, {}, MonotonicClock())
    assert caught.value.name == "INTERNAL"
    assert list(tmp_path.iterdir()) == []


WRITER = """
import sys
from pathlib import Path
from cell.clock import MonotonicClock
from cell.store.runs import RunFolder
run = RunFolder.create(Path(sys.argv[1]), "cone-capture", 1, {}, MonotonicClock())
for n in range(10**9):
    run.note("motion", n=n)
    print(n, flush=True)
"""


@pytest.mark.wire
def test_a_killed_process_loses_no_journal_line_that_was_written(tmp_path: Path) -> None:
    child = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    for _ in range(200):
        told = int(child.stdout.readline())
    os.kill(child.pid, signal.SIGKILL)
    child.stdout.close()
    child.wait(10)
    run = interrupted_runs(tmp_path)[0]
    numbers = [line["n"] for line in run.read_journal() if line["kind"] == "motion"]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > told
