"""Transactions and queries on the ledger's file."""

import logging
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import RLock
from typing import Any

from cell.errors import CellError
from cell.store._database import disk_error

log = logging.getLogger("cellward.ledger")


class LedgerFile(ABC):
    """One open database; ``wall`` gives the time of day, s."""

    def __init__(self, path: Path, wall: Callable[[], float], db: sqlite3.Connection) -> None:
        self.path, self._wall, self._db = path, wall, db
        self._lock = RLock()
        self._in_transaction = self._versions_changed = False
        self._broken: dict[str, Any] | None = None

    def close(self) -> None:
        with self._lock:
            self._db.close()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """All or nothing; a method called inside another one's transaction joins it."""
        with self._lock:
            if self._in_transaction:
                yield self._db
                return
            self._in_transaction = True  # ours, and not the database's: that of a failed rollback stays open
            try:
                self._db.execute("BEGIN IMMEDIATE")
                self._versions_changed = False
                yield self._db
                if self._versions_changed:
                    self._copy_versions()
                self._db.execute("COMMIT")
                if self._versions_changed:
                    self._versions_written()
            except sqlite3.Error as exc:
                raise self._refusal(exc) from exc
            finally:
                self._in_transaction = False
                with suppress(sqlite3.Error):  # what ended the transaction is told, not what followed
                    if self._db.in_transaction:
                        self._db.execute("ROLLBACK")

    def _rows(self, query: str, *values: Any) -> list[dict[str, Any]]:
        with self._lock:
            try:
                return [dict(row) for row in self._db.execute(query, values).fetchall()]
            except sqlite3.Error as exc:
                raise self._refusal(exc) from exc

    def _refusal(self, exc: sqlite3.Error) -> CellError:
        """SQLite's complaint as a coded error; a damaged file is remembered until it is closed."""
        refusal = disk_error(self.path, exc)
        if refusal.name == "LEDGER_DAMAGED" and self._broken is None:
            self._broken = {"aside": None, "at": self._wall(), "still_open": refusal.detail}
            log.error("%s", refusal)
        return refusal

    @abstractmethod
    def _copy_versions(self) -> None:
        """What has to succeed before changed versions are committed."""

    @abstractmethod
    def _versions_written(self) -> None:
        """Changed versions are in the file."""
