"""Records beside the calibrations: audit, small state, trends and items on the belt."""

import json
import sqlite3
from collections.abc import Mapping
from typing import Any

from cell.store._ledger_file import LedgerFile
from cell.store.files import to_json

MAX_AUDIT_REFUSED, MAX_AUDIT_ACCEPTED = 20_000, 1_000_000
MAX_ITEMS, MAX_TREND_POINTS = 500_000, 100_000
ROTATE_EVERY = 1000  # lines; the search for the oldest one reads the table


class Records(LedgerFile):
    """Tables that only grow, the oldest lines leaving, and a table of small values."""

    def audit(self, channel: str, who: str, what: str, accepted: bool, detail: str = "") -> None:
        """One line for a write from outside that was carried out or refused.

        The newest ``MAX_AUDIT_REFUSED`` and ``MAX_AUDIT_ACCEPTED`` lines are kept, each kind on its own.
        """
        with self._transaction() as db:
            cursor = db.execute(
                "INSERT INTO audit (at, channel, who, what, accepted, detail) VALUES (?, ?, ?, ?, ?, ?)",
                (self._wall(), channel, who, what, int(accepted), detail),
            )
            if (cursor.lastrowid or 0) % ROTATE_EVERY == 0:
                for kind, most in ((0, MAX_AUDIT_REFUSED), (1, MAX_AUDIT_ACCEPTED)):
                    db.execute(
                        "DELETE FROM audit WHERE accepted = ? AND id <= (SELECT id FROM audit"
                        " WHERE accepted = ? ORDER BY id DESC LIMIT 1 OFFSET ?)",
                        (kind, kind, most),
                    )

    def audit_lines(
        self, limit: int = 100, *, channel: str | None = None, who: str | None = None, refused: bool = False
    ) -> list[dict[str, Any]]:
        """The newest audit lines first; ``who`` is a part of the name, in any case."""
        rows = self._rows(
            "SELECT * FROM audit WHERE (? IS NULL OR channel = ?)"
            " AND (? IS NULL OR instr(lower(who), lower(?))) AND NOT (? AND accepted)"
            " ORDER BY id DESC LIMIT ?",
            channel,
            channel,
            who,
            who,
            refused,
            limit,
        )
        return [{**row, "accepted": bool(row["accepted"])} for row in rows]

    def get_state(self, key: str, default: Any = None) -> Any:
        """A small value that survives a restart, such as a channel's acknowledged sequence."""
        rows = self._rows("SELECT value FROM state WHERE key = ?", key)
        return json.loads(rows[0]["value"]) if rows else default

    def set_state(self, key: str, value: Any) -> None:
        with self._transaction() as db:
            db.execute(
                "INSERT INTO state (key, value) VALUES (?, ?)"
                " ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                (key, to_json(value)),
            )

    def add_trend(self, name: str, value: float) -> None:
        """One point of a health number, now; in wall time, for it spans restarts.

        The newest ``MAX_TREND_POINTS`` of all numbers together are kept.
        """
        with self._transaction() as db:
            point = name, self._wall(), value
            cursor = db.execute("INSERT INTO trends (name, t, value) VALUES (?, ?, ?)", point)
            _forget_old(db, "trends", cursor.lastrowid, MAX_TREND_POINTS)

    def trend(self, name: str, limit: int = 1000) -> list[tuple[float, float]]:
        """The newest ``limit`` points of a health number, oldest first, in whatever way the clock was set."""
        rows = self._rows(
            "SELECT t, value FROM trends WHERE name = ? ORDER BY rowid DESC LIMIT ?", name, limit
        )
        return [(row["t"], row["value"]) for row in reversed(rows)]

    def trend_names(self) -> list[str]:
        """The health numbers that have a point, in the order of their names."""
        return [str(row["name"]) for row in self._rows("SELECT DISTINCT name FROM trends ORDER BY name")]

    def add_item(self, run_id: int, item: int, t: float, outcome: str, detail: Mapping[str, Any]) -> None:
        """What became of one item on the belt; ``t`` in cell time. The newest ``MAX_ITEMS`` are kept here,
        and those of a run in its journal."""
        with self._transaction() as db:
            cursor = db.execute(
                "INSERT INTO items (run_id, item, t, outcome, detail) VALUES (?, ?, ?, ?, ?)",
                (run_id, item, t, outcome, to_json(detail)),
            )
            _forget_old(db, "items", cursor.lastrowid, MAX_ITEMS)

    def items(self, run_id: int) -> list[dict[str, Any]]:
        """The items of a run in the order they were written."""
        rows = self._rows("SELECT item, t, outcome, detail FROM items WHERE run_id = ? ORDER BY id", run_id)
        return [{**row, "detail": json.loads(row["detail"])} for row in rows]


def _forget_old(db: sqlite3.Connection, table: str, newest: int | None, most: int) -> None:
    """Rows never come back to a table, so their numbers tell which are old."""
    if newest is not None and newest % ROTATE_EVERY == 0:
        db.execute(f"DELETE FROM {table} WHERE rowid <= ?", (newest - most,))
