"""The second copy of the committed calibrations: one JSON file beside the ledger, whole or absent.

It is written before the ledger's transaction ends, so an acknowledged commit is always in both. It holds the
versions in effect and those that a rollback can return to, under a check sum.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from cell.store.files import read_json, to_json, write_atomic

SCHEMA = "cellward.calibrations/1"
FILE = "calibrations.json"
STATES = ("committed", "superseded")
COLUMNS = (
    "id", "name", "state", "version", "value", "run_id", "config_value", "proposed", "decided", "who", "why",
    "arm_model",
)  # fmt: skip


def write_copy(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the copy in ``folder``: ``rows``, as stored in the ledger; ``DISK_FULL``, ``DISK_FAILED``."""
    kept = [{key: row[key] for key in COLUMNS} for row in rows]
    document = {"schema": SCHEMA, "sha256": _check_sum(kept), "calibrations": kept}
    write_atomic(folder / FILE, to_json(document, indent=1))


def read_copy(folder: Path) -> list[dict[str, Any]]:
    """The rows of the copy; ``FILE_MISSING``, or ``FILE_UNREADABLE`` when it is not intact and consistent."""
    path = folder / FILE
    document = read_json(path)
    rows = document.get("calibrations") if isinstance(document, dict) else None
    if not isinstance(rows, list) or document.get("schema") != SCHEMA:
        raise error("FILE_UNREADABLE", f"{path}: schema '{SCHEMA}' was expected")
    if document.get("sha256") != _check_sum(rows):
        raise error("FILE_UNREADABLE", f"{path}: its check sum does not match, so it was damaged or edited")
    committed = [row["name"] for row in rows if row["state"] == "committed"]
    if len(set(committed)) != len(committed):
        raise error("FILE_UNREADABLE", f"{path}: two versions of one calibration are in effect")
    return rows


def copy_or_reason(folder: Path) -> tuple[list[dict[str, Any]], str | None]:
    """The rows of the copy, or none and why."""
    try:
        return read_copy(folder), None
    except CellError as exc:
        return [], exc.detail


def _check_sum(rows: list[dict[str, Any]]) -> str:
    return hashlib.sha256(to_json(rows).encode("utf-8")).hexdigest()
