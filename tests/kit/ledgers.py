"""A ledger with the pose of a camera in it, for tests of the store."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from cell.store.ledger import Ledger

NAME = "T_flange_camera"
CONFIG = [0, -0.08, 0.05, 0, 0, 0]


@pytest.fixture
def subject(tmp_path: Path) -> Iterator[Ledger]:
    ledger = Ledger(tmp_path / "ledger.sqlite", lambda: 1_700_000_000.0)
    yield ledger
    ledger.close()


def propose(ledger: Ledger, x: float, config: object = CONFIG) -> int:
    return ledger.propose(NAME, [x, 0, 0, 0, 0, 0], {"verdict": "pass"}, 1, config)


def damage_schema(path: Path) -> None:
    other = sqlite3.connect(path)
    other.executescript(
        "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = 'no words of SQL' WHERE name = 'runs';"
        "PRAGMA schema_version = 1000;"
    )
    other.close()
