"""A ledger that a daemon begins to write while somebody reads it who may do no more."""

import os
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from cell.store._database import disk_error
from cell.store.ledger import Ledger
from tests.kit.ledgers import damage_schema


@pytest.fixture
def subject(tmp_path: Path) -> Path:
    """The file of a ledger that nobody has open."""
    path = tmp_path / "ledger.sqlite"
    Ledger(path).close()
    return path


def only_reading(patch: pytest.MonkeyPatch, repair: Any = None) -> list[int]:
    """No folder can be written to; ``repair`` is called before the second look at that."""
    looks: list[int] = []

    def access(path: Path, mode: int, **_: object) -> bool:
        if mode != os.W_OK:
            return True
        looks.append(mode)
        if repair is not None and len(looks) == 2:
            repair()
        return False

    patch.setattr(os, "access", access)
    return looks


def corrupt() -> sqlite3.DatabaseError:
    found = sqlite3.DatabaseError("database disk image is malformed")
    found.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    return found


def test_what_looks_damaged_once_is_opened_again(subject: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = subject.read_bytes()
    damage_schema(subject)
    looks = only_reading(monkeypatch, lambda: subject.write_bytes(whole))
    reading = Ledger(subject, read_only=True)
    assert len(looks) == 2
    assert reading.results() == []
    reading.close()


def test_what_is_damaged_twice_is_damaged(subject: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    damage_schema(subject)
    only_reading(monkeypatch)
    with pytest.raises(CellError) as refused:
        Ledger(subject, read_only=True)
    assert refused.value.name == "LEDGER_DAMAGED"
    assert disk_error(subject, corrupt()).name == "LEDGER_DAMAGED"


def test_a_query_that_met_a_change_is_to_be_asked_again(
    subject: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert disk_error(subject, corrupt()).name == "LEDGER_DAMAGED", "of who may write"
    only_reading(monkeypatch)
    refused = disk_error(subject, corrupt())
    assert refused.name == "NOT_NOW"
    assert "ask again" in str(refused)
