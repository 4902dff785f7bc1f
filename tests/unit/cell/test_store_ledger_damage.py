"""A ledger that is corrupt, damaged while it is open, or on a disk that fails."""

import sqlite3
from pathlib import Path

import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from daemon.state_folder import damage_text
from tests.kit.ledgers import CONFIG, NAME, damage_schema, propose, subject

__all__ = ["subject"]


@pytest.mark.parametrize("junk", [b"not a database at all" * 99, b"SQLite format 3\0" + b"\xff" * 8192])
def test_a_corrupt_ledger_is_set_aside_and_numbering_goes_on_behind_the_run_folders(
    tmp_path: Path, junk: bytes
) -> None:
    RunFolder.create(tmp_path / "runs", "cone-capture", 12, {}, MonotonicClock()).close()
    (tmp_path / "ledger.sqlite").write_bytes(junk)
    subject = Ledger(tmp_path / "ledger.sqlite")
    assert subject.aside is not None
    assert subject.aside.read_bytes() == junk
    assert subject.next_run_id() == 13
    subject.close()
    again = Ledger(tmp_path / "ledger.sqlite")
    assert again.aside is None
    again.close()


def test_a_ledger_that_cannot_be_opened_says_where(tmp_path: Path) -> None:
    with pytest.raises(CellError, match=str(tmp_path / "absent")) as caught:
        Ledger(tmp_path / "absent" / "ledger.sqlite")
    assert caught.value.name == "DISK_FAILED"


def test_a_full_disk_is_named_and_leaves_the_ledger_usable(subject: Ledger) -> None:
    subject._db.execute("PRAGMA max_page_count = 1")
    with pytest.raises(CellError) as caught:
        for _ in range(200):
            subject.propose(NAME, "x" * 4000, {}, 1, None)
    assert caught.value.name == "DISK_FULL"
    subject._db.execute("PRAGMA max_page_count = 100000")
    assert propose(subject, 0.1) > 0


def test_a_ledger_that_is_damaged_while_it_is_open_refuses_with_a_code(subject: Ledger) -> None:
    damage_schema(subject.path)
    for call in (
        subject.waiting_results,
        lambda: subject.end_run(1, "complete", None),
        lambda: subject.effective(NAME, CONFIG),
    ):
        with pytest.raises(CellError, match=r"ledger\.sqlite: ") as refused:
            call()
        assert refused.value.name == "LEDGER_DAMAGED"
        assert "cellward recover" in refused.value.hint


def test_damage_that_is_found_while_the_ledger_is_open_is_told_until_it_was_opened_anew(
    subject: Ledger, caplog: pytest.LogCaptureFixture
) -> None:
    damage_schema(subject.path)
    assert subject.damage() is None
    for _ in range(2):
        with pytest.raises(CellError):
            subject.end_run(1, "complete", None)
    told = subject.damage()
    assert told is not None
    assert "start the daemon anew" in damage_text(told)
    assert len(caplog.records) == 1
    with pytest.raises(CellError, match="still damaged") as refused:
        subject.acknowledge_damage()
    assert refused.value.name == "NOT_NOW"


class NoWayBack:
    """A connection on which a commit and the rollback after it fail, as on a disk that went away."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db

    def __getattr__(self, name: str) -> object:
        return getattr(self.db, name)

    def execute(self, query: str, *values: object) -> object:
        if query in ("COMMIT", "ROLLBACK"):
            raise sqlite3.OperationalError("disk I/O error")
        return self.db.execute(query, *values)


def test_a_transaction_that_cannot_be_taken_back_hides_no_later_write(
    subject: Ledger, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(subject, "_db", NoWayBack(subject._db))
        with pytest.raises(CellError, match="disk I/O error"):
            subject.set_state("a", 1)
    with pytest.raises(CellError, match="transaction"):
        subject.set_state("b", 2)  # refused, or it would wait for a commit that never comes
    subject.set_state("c", 3)
    again = sqlite3.connect(subject.path)
    assert again.execute("SELECT key FROM state").fetchall() == [("c",)]
    again.close()
