"""What comes back of a ledger that was damaged or is missing, and what does not."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from cell.store.calibration_copy import COLUMNS, FILE, copy_or_reason
from cell.store.files import contents, free_name_aside, write_atomic


def bring_back(db: sqlite3.Connection, folder: Path) -> dict[str, Any]:
    """Enter what the copy in ``folder`` holds into a new ledger, in the transaction that is open.

    Returns ``restored`` (versions in effect by name), ``why_not`` (None: all that was committed came back)
    and ``copy_aside``: a copy that did not bring all back is kept under this name as well, for the next
    commit writes another. ``DISK_FULL``, ``DISK_FAILED``.
    """
    rows, why_not = copy_or_reason(folder)
    for row in rows:
        db.execute(
            f"INSERT INTO calibrations ({', '.join(COLUMNS)}, result)"
            f" VALUES ({', '.join('?' for _ in COLUMNS)}, '{{}}')",
            [row[key] for key in COLUMNS],
        )
    restored = {row["name"]: row["version"] for row in rows if row["state"] == "committed"}
    kept = _kept(folder / FILE) if why_not is not None else None
    return {"restored": restored, "why_not": why_not, "copy_aside": kept}


def _kept(copy: Path) -> str | None:
    """The name of a second copy; None where there is none to be read. The first stays until the transaction
    is through: a start that fails before is tried again."""
    try:
        content = contents(copy)
    except OSError:
        return None
    target = free_name_aside(copy)
    write_atomic(target, content)
    return str(target)


def waiting_in(aside: Path) -> list[dict[str, Any]] | None:
    """``result_id``, ``name`` and ``run_id`` of the results that waited for a decision in a damaged ledger,
    as far as it can be read; None when it cannot. What stood only in its write-ahead log is not seen."""
    try:
        with closing(sqlite3.connect(f"{aside.absolute().as_uri()}?immutable=1", uri=True)) as db:
            rows = db.execute(
                "SELECT id, name, run_id FROM calibrations"
                " WHERE state IN ('proposed', 'accepted') ORDER BY id"
            ).fetchall()
    except sqlite3.Error:
        return None
    return [{"result_id": row[0], "name": row[1], "run_id": row[2]} for row in rows]
