"""``cellward recover`` brings back what the copy of the ledger holds, and says what is lost."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from cell.errors import error
from cell.store.calibration_copy import FILE
from cell.store.ledger import Ledger
from daemon.state_folder import claimed
from tests.kit.cli_harness import CellOnDisk, CommandLine

NAME = "T_flange_camera"


@pytest.fixture
def cell(tmp_path: Path) -> CellOnDisk:
    """Two versions of a calibration, and a result that waits for a decision."""
    cell = CellOnDisk(tmp_path)
    cell.state.mkdir()
    ledger = Ledger(cell.state / "ledger.sqlite")
    for run_id in (1, 2):
        ledger.accept(ledger.propose(NAME, [0.1 * run_id] * 6, {"verdict": "pass"}, run_id, None), "anna")
    ledger.propose("belt.b1", {"a": 1}, {"verdict": "pass"}, 3, None)
    ledger.close()
    return cell


def tear(path: Path) -> None:
    """The last page is lost, which holds indexes: tables before it can still be read."""
    data = path.read_bytes()
    path.write_bytes(data[:-4096] + b"\xff" * 4096)


def spoil_tables(path: Path) -> None:
    """What is in them; the first page, which lists them, is whole."""
    data = path.read_bytes()
    path.write_bytes(data[:4096] + b"\xff" * (len(data) - 4096))


DAMAGES: dict[str, Callable[[Path], object]] = {
    "garbage": lambda path: path.write_bytes(b"\xff" * 20_000),
    "missing": Path.unlink,
    "torn": tear,
}


@pytest.mark.parametrize("how", DAMAGES)
def test_what_was_committed_comes_back_and_what_is_lost_is_said(
    cell: CellOnDisk, subject: CommandLine, how: str
) -> None:
    DAMAGES[how](cell.state / "ledger.sqlite")
    done = subject("recover")
    assert done.code == 0
    assert f"{NAME} version 2" in done.out
    assert "Lost: results that waited for a decision, audit, trends, items" in done.out
    told = json.loads(subject("recover", "--json").out)
    assert told["in_effect"] == {NAME: 2}
    assert told["damage"]["restored"] == {NAME: 2}
    assert (told["damage"]["aside"] is None) == (how == "missing")
    waiting = [{"result_id": 3, "name": "belt.b1", "run_id": 3}] if how == "torn" else None
    assert told["lost"]["waiting_results"] == waiting
    ledger = Ledger(cell.state / "ledger.sqlite")
    assert ledger.rollback(NAME, "anna")["value"] == [0.1] * 6
    ledger.close()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (DAMAGES["garbage"], ("results",)),
        (DAMAGES["missing"], ("results",)),
        (spoil_tables, ("results",)),
        (spoil_tables, ("audit",)),
        (spoil_tables, ("prune", "--runs", "1", "--yes")),
    ],
    ids=["garbage", "missing", "tables", "audit", "prune"],
)
def test_who_meets_a_lost_ledger_is_told_what_brings_it_back(
    cell: CellOnDisk, subject: CommandLine, damage: Callable[[Path], object], words: tuple[str, ...]
) -> None:
    damage(cell.state / "ledger.sqlite")
    done = subject(*words)
    assert (done.code, done.out) == (3, "")
    assert "The ledger is damaged or missing" in done.err
    assert "cellward recover" in done.err
    subject("recover")
    assert f"{NAME} " in subject("results").out


def test_an_intact_ledger_is_left_as_it_is(cell: CellOnDisk, subject: CommandLine) -> None:
    done = subject("recover")
    assert (done.code, done.out) == (0, "")
    assert "intact" in done.err
    told = json.loads(subject("recover", "--json").out)
    assert (told["damage"], told["in_effect"]) == (None, {NAME: 2})
    ledger = Ledger(cell.state / "ledger.sqlite", read_only=True)
    assert len(ledger.waiting_results()) == 1
    ledger.close()


def test_a_copy_that_is_damaged_too_is_kept_and_named(cell: CellOnDisk, subject: CommandLine) -> None:
    DAMAGES["garbage"](cell.state / "ledger.sqlite")
    (cell.state / FILE).write_text("{")
    done = subject("recover")
    assert done.code == 1, "nothing came back"
    assert "no calibration came back" in done.out
    kept = cell.state / f"{FILE}.corrupt-1"
    assert f"is kept as {kept}" in done.out
    subject("recover")
    assert kept.read_text() == "{"


def test_a_running_daemon_and_a_folder_with_nothing_in_it_are_refused_by_name(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    with claimed(cell.state):
        assert "one keeps its state in" in subject("recover").err
    for name in ("ledger.sqlite", FILE):
        (cell.state / name).unlink()
    done = subject("recover")
    assert done.code == 2
    assert "neither a ledger nor calibrations.json" in done.err
    assert not (cell.state / "ledger.sqlite").exists()


def test_a_start_that_could_not_bring_them_back_is_made_good_by_the_next(
    cell: CellOnDisk, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise error("DISK_FULL", "here")

    DAMAGES["garbage"](cell.state / "ledger.sqlite")
    with monkeypatch.context() as patch:
        patch.setattr("cell.store.ledger.bring_back", full)
        assert subject("recover").code == 3
    assert json.loads(subject("recover", "--json").out)["in_effect"] == {NAME: 2}
