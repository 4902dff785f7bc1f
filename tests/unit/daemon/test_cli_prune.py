"""``cellward prune`` removes what nothing rests on, and nothing else."""

import getpass
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from cell.store.ledger import Ledger
from cell.store.pruning import Keep, plan
from cell.store.runs import RunFolder
from procedures.hand_eye.record import CaptureRecord
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result
from tests.kit.hand_eye_scene import make_scene
from tests.kit.solved import solve_hand_eye

NAME = "T_flange_camera"


@dataclass
class Runs:
    """A cell with ended runs 1 to 6."""

    cell: CellOnDisk

    def __post_init__(self) -> None:
        for run_id in range(1, 7):
            self.cell.add_run(run_id, hand_eye_result(), outcome="complete", verdict="pass")
        Ledger(self.cell.state / "ledger.sqlite").close()

    @property
    def left(self) -> list[int]:
        return sorted(int(p.name.rpartition("_")[2]) for p in (self.cell.state / "runs").glob("*_*_*"))

    def propose(self, run_id: int) -> tuple[Ledger, int]:
        ledger = Ledger(self.cell.state / "ledger.sqlite")
        return ledger, ledger.propose(NAME, [0.1 * run_id] * 6, {"verdict": "pass"}, run_id, None)


@pytest.fixture
def runs(tmp_path: Path) -> Runs:
    return Runs(CellOnDisk(tmp_path))


@pytest.fixture
def subject(runs: Runs, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> CommandLine:
    return CommandLine(monkeypatch, capsys, runs.cell.config)


def test_a_dry_run_tells_what_each_run_frees_and_removes_nothing(runs: Runs, subject: CommandLine) -> None:
    done = json.loads(subject("prune", "--runs", 2, "--dry-run", "--json").out)
    assert [run["run_id"] for run in done["runs"]] == [1, 2, 3, 4]
    folder = next((runs.cell.state / "runs").glob("*_1"))
    assert done["runs"][0]["bytes"] == sum(p.stat().st_size for p in folder.iterdir())
    assert done["bytes"] == sum(run["bytes"] for run in done["runs"])
    assert (done["removed"], runs.left) == (False, [1, 2, 3, 4, 5, 6])


def test_the_runs_beyond_the_bound_go_and_are_recorded(runs: Runs, subject: CommandLine) -> None:
    assert subject("prune", "--runs", 2, "--yes").code == 0
    assert runs.left == [5, 6]
    lines = (runs.cell.state / "runs" / "pruned.jsonl").read_text().splitlines()
    assert [json.loads(line)["run_id"] for line in lines] == [1, 2, 3, 4]
    assert [row["run_id"] for row in json.loads(subject("runs", "--json").out)] == [5, 6]


def test_nothing_that_a_calibration_rests_on_goes(runs: Runs, subject: CommandLine) -> None:
    for run_id, decision in ((1, "accept"), (2, "accept"), (3, "reject"), (4, "wait")):
        ledger, result_id = runs.propose(run_id)
        if decision == "accept":  # the second supersedes the first, to which a rollback returns
            ledger.accept(result_id, "anna")
        elif decision == "reject":
            ledger.reject(result_id, "anna", "")
        ledger.close()
    assert subject("prune", "--days", 0, "--yes").code == 0
    assert runs.left == [1, 2, 4, 6], "in effect, returned to, waiting, newest"


def test_a_run_without_an_end_stays_for_it_may_be_the_one_that_goes_on(
    runs: Runs, subject: CommandLine
) -> None:
    runs.cell.add_run(7)
    runs.cell.add_run(8, outcome="complete")
    assert subject("prune", "--days", 0, "--yes").code == 0
    assert runs.left == [7, 8]


def test_the_oldest_go_until_the_size_is_kept(runs: Runs) -> None:
    folder = runs.cell.state / "runs"
    for path in folder.iterdir():
        (path / "large").write_bytes(bytes(1_000_000))
    removals = plan(folder, Keep(size_gb=0.0031), {2: NAME})
    assert [removal.run_id for removal in removals] == [1, 3, 4]


def test_the_bounds_of_the_configuration_hold_without_options(runs: Runs, subject: CommandLine) -> None:
    bare = subject("prune", "--yes")
    assert (bare.code, runs.left) == (2, [1, 2, 3, 4, 5, 6])
    assert "[cell.keep]" in bare.err
    with runs.cell.config.open("a") as file:
        file.write("[cell.keep]\nruns = 3\n")
    done = subject("prune", "--yes")
    assert runs.left == [4, 5, 6], done.err


def test_a_ledger_that_was_damaged_and_not_looked_at_keeps_every_run(
    runs: Runs, subject: CommandLine
) -> None:
    path = runs.cell.state / "ledger.sqlite"
    path.write_bytes(b"\xff" * 20_000)
    Ledger(path).close()
    done = subject("prune", "--days", 0, "--yes")
    assert (done.code, runs.left) == (4, [1, 2, 3, 4, 5, 6])
    assert "acknowledge-ledger" in done.err


def test_no_answer_on_the_terminal_removes_nothing(runs: Runs, subject: CommandLine) -> None:
    subject("prune", "--runs", 1)
    assert runs.left == [1, 2, 3, 4, 5, 6]


def test_a_run_that_became_needed_while_the_question_stood_is_kept(
    runs: Runs, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def propose_and_agree(*_: object, **__: object) -> bool:
        ledger, _id = runs.propose(2)
        ledger.close()
        return True

    monkeypatch.setattr("typer.confirm", propose_and_agree)
    done = subject("prune", "--runs", 2)
    assert (done.code, runs.left) == (4, [1, 2, 3, 4, 5, 6])
    assert "run 2 changed since the list was shown, and nothing was removed" in done.err


def test_an_answer_of_yes_removes_what_was_shown(
    runs: Runs, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("typer.confirm", lambda *_, **__: True)
    assert subject("prune", "--runs", 2).code == 0
    assert runs.left == [5, 6]


@pytest.fixture
def capture(runs: Runs) -> RunFolder:
    """A complete capture of run 7 with colour and depth of each pose, and pictures of failed tries."""
    run = runs.cell.add_run(7)
    path = make_scene(3).write(run.path)
    images = run.path / "images"
    images.mkdir()
    data = json.loads(path.read_text())
    for k, observation in enumerate(data["observations"]):
        colour, depth = f"images/{k:04d}-1.png", f"images/{k:04d}-1-depth.png"
        frame: dict[str, Any] = {"corners": observation.pop("corners"), "image": colour, "depth": depth}
        observation |= {"frames": [frame], "image": colour}
        for name in (colour, depth, f"images/{k:04d}-0.png"):
            (run.path / name).write_bytes(bytes(1000))
    (run.path / "capture.json").write_text(json.dumps(data))
    result = solve_hand_eye(run.path / "capture.json")
    run.write_result(result)
    run.finish({"outcome": "complete", "verdict": result["verdict"]})
    return run


def test_pictures_that_no_corner_came_from_go_and_the_capture_replays_to_the_same_answer(
    capture: RunFolder, subject: CommandLine
) -> None:
    assert subject("replay", 7).code == 0
    before = subject("solve", "hand-eye", capture.path / "capture.json", "--json").out
    done = json.loads(subject("prune", "--pictures", "--yes", "--json").out)
    assert [(run["run_id"], run["pictures"], run["bytes"]) for run in done["runs"]] == [(7, 40, 40_000)]
    assert len(list((capture.path / "images").iterdir())) == 20
    assert subject("replay", 7).code == 0
    after = subject("solve", "hand-eye", capture.path / "capture.json", "--json").out
    for key in ("result", "uncertainty", "residuals", "heldout", "verdict"):
        assert json.loads(after)[key] == json.loads(before)[key]
    assert json.loads(subject("prune", "--pictures", "--yes", "--json").out)["runs"] == []


def test_a_run_that_is_gone_is_told_by_whom_when_and_why_and_what_is_kept(
    runs: Runs, subject: CommandLine
) -> None:
    subject("prune", "--runs", 5, "--yes")
    for words in (("show", 1), ("report", 1), ("replay", 1), ("compare", 1, 2)):
        done = subject(*words)
        assert done.code == 2
        assert re.search(
            r"the folder of run 1 \(cone-capture, 0\.0 MB\) was removed by 'cellward prune' on "
            rf"\d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d by {getpass.getuser()}, "
            r"for it was older than the newest 5 runs; kept are its line in runs/pruned.jsonl "
            r"and what the ledger holds",
            done.err,
        ), done.err
    assert "removed" not in subject("show", 9).err


def test_a_removal_is_in_the_audit_and_a_torn_line_of_the_record_hides_no_other(
    runs: Runs, subject: CommandLine
) -> None:
    ledger = Ledger(runs.cell.state / "ledger.sqlite", wall=lambda: 1e9)
    ledger.audit("control", "anna", "accept", True)
    ledger.close()
    subject("prune", "--runs", 4, "--yes")
    with (runs.cell.state / "runs" / "pruned.jsonl").open("a") as file:
        file.write('[]\n{"at": 1}\n{"at": ')
    lines = json.loads(subject("audit", "--json").out)
    assert [line["what"] for line in lines] == [
        "accept",
        "remove the folder of run 1 (cone-capture)",
        "remove the folder of run 2 (cone-capture)",
    ]
    assert [line["channel"] for line in lines] == ["control", "prune", "prune"]
    assert json.loads(subject("audit", "--json", "--channel", "prune", "-n", 1).out)[0]["what"].endswith(
        "2 (cone-capture)"
    )
    assert json.loads(subject("audit", "--json", "--refused").out) == []
    assert json.loads(subject("audit", "--json", "--who", "ANNA").out)[0]["who"] == "anna"


def test_a_capture_that_lost_pictures_says_so(capture: RunFolder, subject: CommandLine) -> None:
    subject("prune", "--pictures", "--yes")
    assert "40 pictures (0.0 MB) were removed by 'cellward prune'" in subject("show", capture.run_id).out


def test_a_picture_that_another_run_shares_frees_nothing(capture: RunFolder, subject: CommandLine) -> None:
    spare = capture.path / "images" / "0000-0.png"
    os.link(spare, capture.path.parent / "elsewhere.png")
    done = json.loads(subject("prune", "--pictures", "--dry-run", "--json").out)
    assert done["runs"][0]["bytes"] == 39_000
    assert spare.exists()


def test_a_pruned_capture_can_still_be_taken_over_by_another_run(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("old", "new")]
    for folder in folders:
        folder.mkdir()
    old, subject = (CaptureRecord(folder) for folder in folders)
    old.begin({})
    frame = {"image": "images/0000-0.png", "depth": "images/0000-0-depth.png", "corners": []}
    (folders[0] / frame["image"]).write_bytes(b"colour")
    old.add_pose({"index": 0, "group": 0, "planned": 0, "frames": [frame]})
    subject.begin({}, adopted=old)
    assert (folders[1] / frame["image"]).read_bytes() == b"colour"
    assert subject.observations == old.observations
