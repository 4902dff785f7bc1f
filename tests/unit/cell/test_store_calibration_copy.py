"""Committed calibrations are kept twice, and come back when the ledger was damaged."""

import json
import shutil
from pathlib import Path

import pytest

import cell.store.ledger
from cell.errors import CellError, error
from cell.store.calibration_copy import FILE, read_copy
from cell.store.ledger import Ledger
from cell.store.summary import whole_result
from tests.kit.cli_harness import CellOnDisk, CommandLine

NAME = "T_flange_camera"
REFERENCE_RESULT = {
    "schema": "cellward.result/1",
    "kind": "laser-reference",
    "verdict": "pass",
    "result": {"tau": 0.0081, "passes": [{"t": i * 1e-4, "q": [i * 1e-5] * 6} for i in range(5000)]},
}


def commit(ledger: Ledger, value: float) -> int:
    result_id = ledger.propose(NAME, [value] * 6, {"verdict": "pass"}, 1, None)
    ledger.accept(result_id, "anna")
    return result_id


def damage(folder: Path) -> None:
    """Two pages in the middle of the database overwritten, as a bad sector leaves it."""
    path = folder / "ledger.sqlite"
    data = bytearray(path.read_bytes())
    data[4096 * 2 : 4096 * 4] = b"\xff" * 8192
    path.write_bytes(data)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    ledger = Ledger(tmp_path / "ledger.sqlite")
    for value in (0.1, 0.2):
        commit(ledger, value)
    ledger.close()
    return tmp_path


def test_a_damaged_ledger_costs_no_committed_calibration(folder: Path) -> None:
    damage(folder)
    subject = Ledger(folder / "ledger.sqlite")
    now = subject.effective(NAME, None)
    assert (now.value, now.version, now.conflict) == ([0.2] * 6, 2, False)
    told = subject.damage()
    assert told is not None
    assert (told["restored"], told["why_not"]) == ({NAME: 2}, None)
    assert subject.rollback(NAME, "anna")["value"] == [0.1] * 6
    assert commit(subject, 0.3) == 3
    subject.close()


def test_the_damage_is_told_at_every_start_until_it_is_acknowledged(folder: Path) -> None:
    damage(folder)
    Ledger(folder / "ledger.sqlite").close()
    subject = Ledger(folder / "ledger.sqlite")
    assert subject.damage() is not None
    subject.acknowledge_damage()
    assert subject.damage() is None
    with pytest.raises(CellError, match="acknowledged"):
        subject.acknowledge_damage()
    subject.close()


@pytest.mark.parametrize("how", ["edited", "cut", "missing"])
def test_a_copy_that_is_not_intact_brings_nothing_back_and_says_why(folder: Path, how: str) -> None:
    damage(folder)
    path = folder / FILE
    if how == "edited":
        path.write_text(path.read_text().replace("0.2", "0.9"))
    elif how == "cut":
        path.write_text(path.read_text()[:-20])
    else:
        path.unlink()
    subject = Ledger(folder / "ledger.sqlite")
    told = subject.damage()
    assert told is not None
    assert FILE in told["why_not"]
    assert subject.effective(NAME, None).version is None
    subject.close()


def test_a_rollback_is_in_the_copy(folder: Path) -> None:
    subject = Ledger(folder / "ledger.sqlite")
    subject.rollback(NAME, "anna")
    subject.close()
    assert [(row["version"], row["state"]) for row in read_copy(folder)[0]] == [(1, "committed")]


def test_a_commit_that_cannot_be_copied_is_not_made(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    subject = Ledger(folder / "ledger.sqlite")

    def full(*_: object) -> None:
        raise error("DISK_FULL", FILE)

    monkeypatch.setattr(cell.store.ledger, "write_copy", full)
    with pytest.raises(CellError, match="full"):
        commit(subject, 0.3)
    assert subject.effective(NAME, None).version == 2
    subject.close()


def test_a_copy_that_is_behind_an_intact_ledger_is_written_again(folder: Path) -> None:
    before = json.loads((folder / FILE).read_text())
    (folder / FILE).write_text("{")
    Ledger(folder / "ledger.sqlite").close()
    assert json.loads((folder / FILE).read_text()) == before


@pytest.fixture
def with_reference(tmp_path: Path) -> Path:
    """A cell with a committed calibration of half a megabyte, which is its run's answer."""
    run = CellOnDisk(tmp_path).add_run(1, REFERENCE_RESULT, outcome="complete", verdict="pass")
    folder = run.path.parent.parent
    ledger = Ledger(folder / "ledger.sqlite")
    value = REFERENCE_RESULT["result"]
    ledger.accept(
        ledger.propose("laser_reference.pin", value, REFERENCE_RESULT, 1, None, folder=run.path.name), "anna"
    )
    ledger.close()
    return folder


def test_a_value_of_megabytes_is_in_the_copy_by_its_run_folder_and_comes_back_exactly(
    with_reference: Path,
) -> None:
    assert (with_reference / FILE).stat().st_size < 2000
    damage(with_reference)
    subject = Ledger(with_reference / "ledger.sqlite")
    assert subject.damage() == {**(subject.damage() or {}), "why_not": None}
    assert subject.effective("laser_reference.pin", None).value == REFERENCE_RESULT["result"]
    row = subject.in_effect("laser_reference.pin")
    assert row is not None
    assert whole_result(row, with_reference / "runs") == REFERENCE_RESULT
    subject.close()


def test_a_value_whose_run_folder_is_gone_is_whole_in_the_copy_from_the_next_start_on(
    with_reference: Path,
) -> None:
    shutil.rmtree(with_reference / "runs")
    Ledger(with_reference / "ledger.sqlite").close()
    damage(with_reference)
    subject = Ledger(with_reference / "ledger.sqlite")
    assert subject.effective("laser_reference.pin", None).value == REFERENCE_RESULT["result"]
    subject.close()


def test_a_value_that_was_edited_in_its_run_folder_does_not_come_back_and_is_named(
    with_reference: Path,
) -> None:
    damage(with_reference)
    ledger = with_reference / "ledger.sqlite"
    path = next((with_reference / "runs").glob("*/result.json"))
    path.write_text(path.read_text().replace("0.0005", "0.0006"))
    subject = Ledger(ledger)
    told = subject.damage()
    assert told is not None
    assert told["restored"] == {}
    assert "laser_reference.pin version 1" in told["why_not"]
    assert str(path) in told["why_not"]
    subject.close()


def test_results_tells_of_the_damage_and_what_came_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    on_disk = CellOnDisk(tmp_path)
    on_disk.state.mkdir()
    ledger = Ledger(on_disk.state / "ledger.sqlite")
    commit(ledger, 0.1)
    ledger.close()
    damage(on_disk.state)
    Ledger(on_disk.state / "ledger.sqlite").close()
    done = CommandLine(monkeypatch, capsys, on_disk.config)("results")
    assert done.code == 0
    assert "the ledger was damaged" in done.err
    assert f"{NAME} version 1" in done.err
    assert NAME in done.out
