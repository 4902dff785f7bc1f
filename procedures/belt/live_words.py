"""The live numbers of picking from a belt on one line."""

from collections.abc import Mapping, Sequence
from typing import Any

from procedures.words import mm

SPAN_S = 1.0  # of the belt that a line sums up
MOST_ITEMS = 4
_CAUSES = ("not_detected", "out_of_zone", "lost", "grip_failed", "queue_full")

Rows = Mapping[str, Sequence[Sequence[float]]]


def live_line(numbers: Mapping[str, float], rows: Rows) -> str:
    """The belt as counted and as estimated, the items by where they are, picks, and misses by cause."""
    parts = [*_belt(rows.get("belt", ())), *_items(rows.get("items", ()))]
    if "picks" in numbers:
        parts.append(f"{numbers['picks']:.0f} picked{_missed(numbers)}")
    if "next_place" in numbers:
        place = numbers["next_place"]
        parts.append(f"place {place:.0f} is next" if place else "all places are filled")
    if waits := numbers.get("place_waits"):
        parts.append(f"waited {waits:.0f} times for a clear place")
    return "  |  ".join(parts) or "nothing yet"


def _belt(rows: Sequence[Sequence[float]]) -> list[str]:
    last = [row for row in rows if row[0] > rows[-1][0] - SPAN_S]
    if not last:
        return []
    raw = [row[2] for row in last]
    off = (sum((row[1] - row[3]) ** 2 for row in last) / len(last)) ** 0.5
    return [
        f"belt {last[-1][4]:.4f} m/s (from two counts {min(raw):.3f} to {max(raw):.3f}), "
        f"counts {mm(off)} RMS beside it"
    ]


def _items(rows: Sequence[Sequence[float]]) -> list[str]:
    now = [row for row in rows if row[0] == rows[-1][0]]
    if not now:
        return []
    shown = ", ".join(f"{row[1]:.0f} at {row[2]:.3f} m" for row in now[:MOST_ITEMS])
    more = f" and {len(now) - MOST_ITEMS} more" if len(now) > MOST_ITEMS else ""
    return [f"item {shown}{more}"]


def _missed(numbers: Mapping[str, Any]) -> str:
    causes = [
        f"{numbers[key]:.0f} {cause.replace('_', ' ')}"
        for cause in _CAUSES
        if numbers.get(key := f"missed_{cause}")
    ]
    total = numbers.get("misses", 0)
    return f", {total:.0f} missed" + (f" ({', '.join(causes)})" if causes else "")
