"""What ``results``, ``runs`` and ``audit`` list fits the terminal; what is piped stays whole."""

import re

import pytest

from cell.store.ledger import Ledger
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result

NUMBER = re.compile(r"-?\d+\.\d+")
POSE = [0.1234567, -0.7, 0.18, 0.0123456, -0.0234567, 3.1]
LISTS = {
    "results": ("laser_reference.gripper", "proposed", "committed", "the spread was looked at"),
    "runs": ("cone-capture", "running or interrupted", "aborted"),
    "audit": ("anna (uid 1000)", "write 100", "refused", "not in allow_clients, and of another network"),
}


@pytest.fixture
def full(cell: CellOnDisk) -> None:
    """A cell with something of every kind, told in long words."""
    cell.add_run(1)
    cell.add_run(2, outcome="aborted", verdict="fail")
    ledger = Ledger(cell.state / "ledger.sqlite")
    first = ledger.propose("T_flange_camera", POSE, hand_eye_result(), 1, None)
    ledger.accept(first, "anna (uid 1000)", why="the spread was looked at")
    ledger.propose("laser_reference.gripper", POSE, hand_eye_result(), 2, None)
    why = "not in allow_clients, and of another network"
    ledger.audit("control", "anna (uid 1000)", "accept", True)
    ledger.audit("modbus", "10.0.0.7:4711", "write 100", False, why)
    ledger.close()


@pytest.mark.usefixtures("full")
@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("command", LISTS)
def test_a_list_fits_the_terminal_and_has_every_word_and_figure_of_the_piped_one(
    command: str, width: int, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    piped = subject(command).out
    with monkeypatch.context() as terminal:
        terminal.setattr("sys.stdout.isatty", lambda: True)
        terminal.setenv("COLUMNS", str(width))
        fitted = subject(command).out
    assert max(map(len, fitted.splitlines())) <= width
    assert sorted(NUMBER.findall(fitted)) == sorted(NUMBER.findall(piped))
    for told in LISTS[command]:
        assert told in piped
        assert told in " ".join(fitted.split()), f"{told} at {width}"
    if command == "results":
        assert max(map(len, piped.splitlines())) > 120, "a pipe gets a line for each result"
