"""``cellward.tracker-samples/1``: what a sampling has measured, a line each, on disk pose by pose.

The first line is the ``header``: ``robot``, ``noise``, ``payload_kg`` as in ``cellward.kincal/1``, the
``serials`` of arm and tracker, and ``max_drift_m``, the limit for a monument. A ``tracker`` line says where
the tracker was found, ``monuments`` what a look at them saw after so many poses, a ``sample`` is a finished
pose. Whatever ends a run, the data set can be made from these lines.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.formats.kincal import SCHEMA as DATA_SCHEMA

SCHEMA = "cellward.tracker-samples/1"
FILE_NAME = "samples.jsonl"
_KEYS: dict[str, tuple[str, ...]] = {
    "header": (),
    "tracker": ("T_base_tracker",),
    "monuments": ("after", "t", "points"),
    "sample": ("q", "p_tracker", "target", "held_out"),
}
_SHARED = ("robot", "noise", "payload_kg")  # of the header, with the data set
_OWN = ("kind", "held_out", "asked_q")  # of a sample's line, not of the data set


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The entries, header first; a line torn by a kill is left out.

    ``FILE_UNREADABLE`` when a whole line is damaged or another job's.
    """
    entries: list[dict[str, Any]] = []
    for number, line in enumerate(path.read_bytes().splitlines(keepends=True), 1):
        if not line.endswith(b"\n"):
            break
        try:
            entry = json.loads(line)
            whole = all(key in entry for key in _KEYS[entry["kind"]])
        except (ValueError, KeyError, TypeError) as exc:
            raise error("FILE_UNREADABLE", f"{path}:{number}: no line of a tracker's samples") from exc
        if not whole or (number == 1 and entry.get("schema") != SCHEMA):
            raise error("FILE_UNREADABLE", f"{path}:{number}: no line of a tracker's samples ({SCHEMA})")
        entries.append(entry)
    return entries


def as_data_set(
    header: Mapping[str, Any], samples: Iterable[Mapping[str, Any]], *, aside: bool
) -> dict[str, Any]:
    """``cellward.kincal/1`` of the poses to solve, or of those set ``aside`` to judge the result."""
    rows = [{k: v for k, v in s.items() if k not in _OWN} for s in samples if bool(s["held_out"]) is aside]
    return {"schema": DATA_SCHEMA, **{k: header[k] for k in _SHARED if k in header}, "samples": rows}
