"""A ledger of an earlier or newer form: taken over, kept as it was, or left alone."""

import sqlite3
from pathlib import Path

import pytest

from cell.errors import CellError
from cell.store import _database
from cell.store.ledger import Effective, Ledger
from tests.kit.ledgers import CONFIG, NAME, propose, subject

__all__ = ["subject"]


@pytest.mark.parametrize(
    ("version", "missing"),
    [(1, ("arm_model", "folder")), (2, ("folder",)), (3, ())],
    ids=["schema 1", "schema 2", "schema 3"],
)
def test_a_ledger_of_an_earlier_schema_is_read_as_it_is_and_taken_over(
    tmp_path: Path, version: int, missing: tuple[str, ...]
) -> None:
    path = tmp_path / "ledger.sqlite"
    old = Ledger(path)
    old.start_run(1, "cone-capture", "20260101T000000Z_cone-capture_1", "anna", "control")
    old.accept(propose(old, 1.0), "test")
    old.close()
    database = sqlite3.connect(path)
    for column in missing:
        database.execute(f"ALTER TABLE calibrations DROP COLUMN {column}")
    database.execute("ALTER TABLE runs DROP COLUMN tool")
    database.executescript(f"PRAGMA user_version = {version};")
    database.close()
    looking = Ledger(path, read_only=True)
    assert [(row["name"], row["arm_model"], row["folder"]) for row in looking.results()] == [
        (NAME, None, None)
    ]
    assert [row["run_id"] for row in looking.runs()] == [1]
    assert looking.effective(NAME, CONFIG).version == 1
    looking.close()
    database = sqlite3.connect(path)
    assert database.execute("PRAGMA user_version").fetchone()[0] == version
    database.close()
    subject = Ledger(path)
    assert subject.aside is None
    assert subject.effective(NAME, CONFIG) == Effective(
        [1.0, 0, 0, 0, 0, 0], 1, False, 1, None, {"verdict": "pass"}
    )
    assert subject.result(1)["result"] == {"verdict": "pass"}
    taken_over = "20260101T000000Z_cone-capture_1" if "folder" in missing else None
    assert subject.result(1)["folder"] == taken_over
    assert subject.runs()[0]["tool"] is None
    subject.accept(subject.propose(NAME, CONFIG, {}, 1, CONFIG, {"name": "controller"}), "test")
    assert subject.effective(NAME, CONFIG).arm_model == {"name": "controller"}
    subject.close()


def of_schema_2(path: Path) -> None:
    """A ledger of that schema with one version in effect."""
    old = Ledger(path)
    old.accept(propose(old, 1.0), "test")
    old.close()
    database = sqlite3.connect(path)
    database.execute("ALTER TABLE calibrations DROP COLUMN folder")
    database.execute("ALTER TABLE runs DROP COLUMN tool")
    database.executescript("PRAGMA user_version = 2;")
    database.close()


def test_the_form_before_is_kept_and_can_be_put_back(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    of_schema_2(path)
    subject = Ledger(path)
    subject.accept(propose(subject, 2.0), "test")
    subject.close()
    copy = tmp_path / "ledger.sqlite.schema-2"
    database = sqlite3.connect(copy)
    columns = [row[1] for row in database.execute("PRAGMA table_info(calibrations)")]
    assert database.execute("PRAGMA user_version").fetchone()[0] == 2
    database.close()
    assert "folder" not in columns
    copy.replace(path)
    again = Ledger(path)
    assert again.effective(NAME, CONFIG).value == [1.0, 0, 0, 0, 0, 0]
    again.close()


def test_a_change_that_fails_leaves_the_ledger_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger.sqlite"
    of_schema_2(path)
    monkeypatch.setitem(_database.STEPS, 2, _database.STEPS[2] + "SELECT 1 FROM nowhere;")
    with pytest.raises(CellError, match="nowhere"):
        Ledger(path)
    monkeypatch.undo()
    subject = Ledger(path)
    assert subject.effective(NAME, CONFIG).version == 1
    subject.close()


def test_a_ledger_of_a_newer_program_is_left_alone(tmp_path: Path, subject: Ledger) -> None:
    subject.close()
    path = tmp_path / "ledger.sqlite"
    with sqlite3.connect(path) as db:
        db.execute("PRAGMA user_version = 9")
    db.close()
    with pytest.raises(CellError, match=r"newer cellward .*\(schema 9\).*ledger.sqlite.schema-4") as caught:
        Ledger(path)
    assert caught.value.name == "STORE_NEWER"
    assert list(tmp_path.glob("*.corrupt*")) == []
