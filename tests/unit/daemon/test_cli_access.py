"""A user who may not read the state folder, or may only read it: a sentence that says whose member to be."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from cell.store.ledger import Ledger
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.permissions import without_override


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[CellOnDisk]:
    """A run, and a calibration in a ledger that no daemon has open."""
    cell = CellOnDisk(tmp_path)
    cell.add_run(1, outcome="complete")
    ledger = Ledger(cell.state / "ledger.sqlite")
    ledger.accept(ledger.propose("T_flange_camera", [0.1] * 6, {"verdict": "pass"}, 1, None), "anna")
    ledger.close()
    yield cell
    cell.state.chmod(0o755)


COMMANDS = {
    "results": ("results",),
    "runs": ("runs",),
    "show": ("show", 1),
    "audit": ("audit",),
    "export": ("export", "T_flange_camera"),
    "prune": ("prune", "--runs", 1, "--dry-run"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_that_this_user_may_not_read_is_one_sentence(
    cell: CellOnDisk, subject: CommandLine, name: str
) -> None:
    cell.state.chmod(0)
    with without_override():
        done = subject(*COMMANDS[name])
    assert (done.code, done.out) == (2, ""), done.err
    assert "Error 4010: This user may not use a file, a folder or a socket" in done.err
    assert str(cell.state) in done.err
    assert "usermod" in done.err


def test_a_ledger_that_this_user_may_not_read_is_one_sentence(cell: CellOnDisk, subject: CommandLine) -> None:
    (cell.state / "ledger.sqlite").chmod(0)
    with without_override():
        done = subject("results")
    assert done.code == 2
    assert "Error 4010" in done.err


def test_who_may_only_read_reads_the_ledger_of_a_daemon_that_is_stopped(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    (cell.state / "ledger.sqlite").chmod(0o440)
    cell.state.chmod(0o550)
    with without_override():
        done = subject("results")
    assert (done.code, done.err) == (0, "")
    assert "T_flange_camera" in done.out


def test_a_socket_that_this_user_may_not_use_is_not_taken_for_a_stopped_daemon(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    folder = cell.config.parent / "run"
    folder.mkdir()
    cell.config.write_text(
        f"[cell]\nstate_dir = '{cell.state}'\ncontrol_socket = '{folder}/control.sock'\n", "utf-8"
    )
    folder.chmod(0)
    with without_override():
        done = subject("status")
    folder.chmod(0o755)
    assert done.code == 2
    assert "Error 4010" in done.err
    assert "systemctl start" not in done.err
