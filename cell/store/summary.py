"""What the ledger keeps of a result: everything short. The whole is in the run folder's ``result.json``.

A crossed-beam reference holds megabytes of passes; the ledger would hold them a second time.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.store.files import read_json, to_json
from cell.store.runs import altered_in, load_run

LEFT_OUT = "left_out"
MAX_ITEM_CHARACTERS = 2000  # of JSON: a covariance (6, 6) is half of it
MAX_KEYS = 64
NEEDED = ("result.lens_cov",)  # what jobs go by, however long
WHOLE = ("schema", "kind", "verdict", "reasons", "warnings")  # what a decision needs, however long


def summary(result: Mapping[str, Any]) -> dict[str, Any]:
    """``result`` without its long lists and tables; ``left_out`` names them, as ``residuals.per_pose``."""
    left_out: list[str] = []
    kept = {
        key: value if key in WHOLE else _short(value, str(key), left_out) for key, value in result.items()
    }
    for name in left_out:
        kept.pop(name, None)
    return {**kept, LEFT_OUT: left_out} if left_out else kept


def whole_result(row: Mapping[str, Any], runs: Path) -> dict[str, Any] | None:
    """The whole result document of a calibration; None where its run folder does not hold it any more, also
    because it was altered after its run.

    ``row`` is one of the ledger's, ``runs`` the folder of the run folders.
    """
    result = row["result"]
    if result and LEFT_OUT not in result:
        return dict(result)
    try:
        folder = runs / row["folder"] if row["folder"] else load_run(runs, row["run_id"]).path
        if altered_in(folder):
            return None
        found = read_json(folder / "result.json")
    except CellError:
        return None
    return found if isinstance(found, dict) else None


def _short(value: Any, where: str, left_out: list[str]) -> Any:
    if isinstance(value, Mapping) and len(value) <= MAX_KEYS:
        kept = {}
        for key, item in value.items():
            begun = len(left_out)
            short = _short(item, f"{where}.{key}", left_out)
            if left_out[begun:] != [f"{where}.{key}"]:
                kept[key] = short
        return kept
    if where not in NEEDED and len(to_json(value)) > MAX_ITEM_CHARACTERS:
        left_out.append(where)
        return None
    return value
