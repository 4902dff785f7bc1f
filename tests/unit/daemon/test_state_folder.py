"""A state folder that cannot be used, or holds one bad run: a clear sentence, and a daemon that starts."""

import errno
import os
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from cell.errors import CellError
from cell.store.files import AppendFile
from cell.store.ledger import Ledger
from cell.store.runs import interrupted_runs
from daemon.cli import failures, setup
from daemon.state_folder import claimed, end_interrupted, make_state_folder
from tests.kit.cli_harness import CellOnDisk, CommandLine


@pytest.fixture
def ledger(cell: CellOnDisk) -> Iterator[Ledger]:
    make_state_folder(cell.state)
    opened = Ledger(cell.state / "ledger.sqlite")
    yield opened
    opened.close()


def test_a_state_folder_that_is_a_file_is_one_sentence(cell: CellOnDisk) -> None:
    cell.state.write_text("not a folder")
    with pytest.raises(CellError, match="runs") as refused:
        make_state_folder(cell.state)
    assert refused.value.name == "DISK_FAILED"


def test_a_state_folder_on_a_read_only_mount_is_one_sentence(
    cell: CellOnDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_state_folder(cell.state)

    def read_only(path: Path, *args: object, **kwargs: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", read_only)
        with pytest.raises(CellError, match="lock: Read-only file system") as refused, claimed(cell.state):
            pass
    assert refused.value.name == "DISK_FAILED"


def test_a_lock_that_is_a_folder_is_one_sentence(cell: CellOnDisk) -> None:
    (cell.state / "lock").mkdir(parents=True)
    with pytest.raises(CellError, match="lock") as refused, claimed(cell.state):
        pass
    assert refused.value.name == "DISK_FAILED"


def test_a_database_of_another_program_is_refused_by_name_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    other = sqlite3.connect(path)
    other.executescript("CREATE TABLE runs (word TEXT); INSERT INTO runs VALUES ('kept')")
    other.close()
    with pytest.raises(CellError, match="another program") as refused:
        Ledger(path)
    assert refused.value.name == "FILE_UNREADABLE"
    again = sqlite3.connect(path)
    assert again.execute("SELECT word FROM runs").fetchall() == [("kept",)]
    again.close()


def test_a_run_whose_journal_is_a_folder_hides_no_other_interrupted_run(
    cell: CellOnDisk, ledger: Ledger
) -> None:
    bad, good = cell.add_run(1), cell.add_run(2)
    (bad.path / "journal.jsonl").unlink()
    (bad.path / "journal.jsonl").mkdir()
    assert end_interrupted(cell.state / "runs", ledger) == [1, 2]
    end = good.read_end()
    assert end is not None
    assert end["outcome"] == "interrupted"


def test_a_run_whose_end_only_the_ledger_lacks_ends_there_as_its_folder_says(
    cell: CellOnDisk, ledger: Ledger
) -> None:
    for number, end in ((1, {"outcome": "complete"}), (2, {}), (3, {})):
        run = cell.add_run(number, **end)
        ledger.start_run(number, run.job, run.path.name, "test", "socket")
    cut_off = interrupted_runs(cell.state / "runs")[-1]  # killed between its last line and end.json
    cut_off.note("state", terminal=True, outcome="stopped", verdict=None, packml="STOPPED", error=None)
    cut_off.close()
    assert end_interrupted(cell.state / "runs", ledger) == [2, 3]
    assert {row["run_id"]: row["outcome"] for row in ledger.runs()} == {
        1: "complete",
        2: "interrupted",
        3: "stopped",
    }
    assert ledger.open_runs() == []


def test_a_full_disk_leaves_an_interrupted_run_to_the_next_start(
    cell: CellOnDisk, ledger: Ledger, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = cell.add_run(1)

    def full(handle: int, data: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        assert end_interrupted(cell.state / "runs", ledger) == [1]
    assert run.read_end() is None
    assert end_interrupted(cell.state / "runs", ledger) == [1]
    assert interrupted_runs(cell.state / "runs") == []


def test_a_run_that_the_ledger_holds_open_and_that_has_no_folder_was_interrupted(
    cell: CellOnDisk, ledger: Ledger
) -> None:
    run = cell.add_run(1)
    ledger.start_run(1, run.job, run.path.name, "test", "socket")
    shutil.rmtree(run.path)
    assert end_interrupted(cell.state / "runs", ledger) == []
    assert ledger.runs()[0]["outcome"] == "interrupted"


def test_only_the_newest_runs_are_opened(
    cell: CellOnDisk, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    import cell.store.runs as store

    for number in range(1, 8):
        cell.add_run(number, outcome="complete")
    opened = []
    read = store.read_json
    monkeypatch.setattr(store, "read_json", lambda path: (opened.append(path.parent.name), read(path))[1])
    done = subject("runs", "-n", 2, "--json")
    assert '"run_id": 6' in done.out
    assert '"run_id": 7' in done.out
    assert len(set(opened)) == 2


def test_a_service_writes_the_details_of_an_internal_error_into_its_log(
    subject: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(failures.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("INVOCATION_ID", "0123456789abcdef")
    monkeypatch.setattr(setup, "find_entry", lambda code: 1 / 0)
    done = subject("explain", "3001")
    assert done.code == 5
    assert "ZeroDivisionError: division by zero (details in the log, above)" in done.err
    assert "Traceback" in done.err
    assert not list(tmp_path.glob("cellward-error-*"))


def test_a_file_that_was_removed_is_no_longer_in_place(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    file = AppendFile(path)
    assert file.in_place()
    path.unlink()
    assert not file.in_place()
    path.write_text("another one")
    assert not file.in_place()
    file.close()
