"""The second copy of the committed calibrations: one JSON file beside the ledger, whole or absent.

It is written before the ledger's transaction ends, so an acknowledged commit is always in both. It holds the
versions in effect and those that a rollback can return to, under a check sum. A value of megabytes (a
crossed-beam reference) that is the answer in its run's ``result.json`` is kept as that folder's name and a
check sum; each writing of the copy looks whether the file still holds it, and else takes in the whole.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from cell.store.files import read_json, to_json, write_atomic

SCHEMA = "cellward.calibrations/2"
SCHEMAS = (SCHEMA, "cellward.calibrations/1")  # the first has no folders and every value whole
FILE = "calibrations.json"
STATES = ("committed", "superseded")
COLUMNS = (
    "id", "name", "state", "version", "value", "run_id", "config_value", "proposed", "decided", "who", "why",
    "arm_model", "folder",
)  # fmt: skip
MAX_VALUE_CHARACTERS = 65536
REFERENCE = "value_in"  # in the place of a large value: the folder of its run
VALUE_SUM = "value_sha256"


def write_copy(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the copy in ``folder``: ``rows``, as stored in the ledger; ``DISK_FULL``, ``DISK_FAILED``."""
    kept = [_kept(folder / "runs", row) for row in rows]
    document = {"schema": SCHEMA, "sha256": _check_sum(kept), "calibrations": kept}
    write_atomic(folder / FILE, to_json(document, indent=1))


def is_current(folder: Path, rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the copy is intact and holds just these ``rows``, and the files that it names their values."""
    try:
        return _read(folder) == [_kept(folder / "runs", row) for row in rows]
    except CellError:
        return False


def holds_rows(folder: Path) -> bool:
    """Whether there is an intact copy with a calibration in it."""
    try:
        return bool(_read(folder))
    except CellError:
        return False


def read_copy(folder: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """The rows of the copy, and a sentence for each whose value is in a run folder that lost it.

    ``FILE_MISSING``, or ``FILE_UNREADABLE`` when the copy is not intact and consistent.
    """
    found, lost = [], []
    for row in _read(folder):
        if REFERENCE not in row:
            found.append({"folder": None, **row})
            continue
        text = _answer(folder / "runs" / row[REFERENCE])
        if text is None or _sum(text) != row[VALUE_SUM]:
            file = folder / "runs" / row[REFERENCE] / "result.json"
            lost.append(
                f"{row['name']} version {row['version']} was in {file}, which does not hold it any more"
            )
        else:
            found.append({key: text if key == "value" else row[key] for key in COLUMNS})
    return found, lost


def copy_or_reason(folder: Path) -> tuple[list[dict[str, Any]], str | None]:
    """The rows of the copy, and why it is not all of what was committed (None: it is)."""
    try:
        rows, lost = read_copy(folder)
    except CellError as exc:
        return [], exc.detail
    return rows, "; ".join(lost) or None


def _read(folder: Path) -> list[dict[str, Any]]:
    path = folder / FILE
    document = read_json(path)
    rows = document.get("calibrations") if isinstance(document, dict) else None
    if not isinstance(rows, list) or document.get("schema") not in SCHEMAS:
        raise error("FILE_UNREADABLE", f"{path}: schema '{SCHEMA}' was expected")
    if document.get("sha256") != _check_sum(rows):
        raise error("FILE_UNREADABLE", f"{path}: its check sum does not match, so it was damaged or edited")
    committed = [row["name"] for row in rows if row["state"] == "committed"]
    if len(set(committed)) != len(committed):
        raise error("FILE_UNREADABLE", f"{path}: two versions of one calibration are in effect")
    return rows


def _kept(runs: Path, row: Mapping[str, Any]) -> dict[str, Any]:
    """One row of the copy; a large value as a reference where its run folder holds just this value."""
    kept = {key: row[key] for key in COLUMNS}
    if (
        len(row["value"]) > MAX_VALUE_CHARACTERS
        and row["folder"]
        and _answer(runs / row["folder"]) == row["value"]
    ):
        del kept["value"]
        kept |= {REFERENCE: row["folder"], VALUE_SUM: _sum(row["value"])}
    return kept


def _answer(folder: Path) -> str | None:
    """The answer of a run as the ledger would store it, None when there is none that can be read."""
    try:
        document = read_json(folder / "result.json")
    except CellError:
        return None
    return to_json(document.get("result")) if isinstance(document, dict) else None


def _sum(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _check_sum(rows: list[dict[str, Any]]) -> str:
    return _sum(to_json(rows))
