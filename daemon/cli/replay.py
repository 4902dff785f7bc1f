"""Is an answer solved again the same answer?"""

from collections.abc import Mapping
from typing import Any

TOLERANCE = 1e-9  # relative; bit-equal is expected, other processor types may round differently
EXPLANATIONS = {"meaning", "direction"}  # words about a figure, and no figure
COMPARED = ("kind", "verdict", "reasons", "result", "uncertainty", "residuals", "heldout", "observability")


def differences(recorded: Mapping[str, Any], now: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every place where two result documents differ. ``inputs`` hold times and are left out.

    ``added`` is true of a place that ``recorded`` does not have at all, unlike one that it has as null: later
    versions record more figures.

    A number is compared relative to the greatest magnitude in its array: the elements of a vector or
    covariance that are zero but for rounding have no relative accuracy of their own.
    """
    found: list[dict[str, Any]] = []
    for key in COMPARED:
        _compare(key, recorded.get(key), now.get(key), 0.0, found)
    return found


def _compare(where: str, a: Any, b: Any, scale: float, found: list[dict[str, Any]]) -> None:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in sorted({*a, *b} - EXPLANATIONS):
            if key in a:
                _compare(f"{where}.{key}", a[key], b.get(key), 0.0, found)
            elif b[key] is not None:
                found.append({"where": f"{where}.{key}", "recorded": None, "now": b[key], "added": True})
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        scale = max(scale, _magnitude(a), _magnitude(b))
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            _compare(f"{where}[{i}]", x, y, scale, found)
    elif not _equal(a, b, scale):
        found.append({"where": where, "recorded": a, "now": b, "added": False})


def _equal(a: Any, b: Any, scale: float) -> bool:
    if _is_number(a) and _is_number(b):
        return bool(abs(a - b) <= TOLERANCE * max(scale, abs(a), abs(b)))
    return bool(a == b)


def _magnitude(values: Any) -> float:
    """The greatest magnitude of the numbers in nested lists."""
    if isinstance(values, list):
        return max((_magnitude(v) for v in values), default=0.0)
    return abs(values) if _is_number(values) else 0.0


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
