"""A run's journal as a timeline for people."""

from collections.abc import Iterable, Mapping
from typing import Any

NOT_SHOWN = {"seq", "t", "kind", "state", "event", "why"}
LONGEST_VALUE = 100


def timeline(journal: Iterable[Mapping[str, Any]]) -> str:
    """One line an entry: seconds since the journal was opened, kind, what happened, and why."""
    lines = []
    origin = None
    for entry in journal:
        if entry["kind"] == "header":
            again = "again " if origin is not None else ""
            origin = entry["t"]  # another process may have another origin of time
            lines.append(f"            journal opened {again}at {entry['wall']}")
            continue
        seconds = entry["t"] - (entry["t"] if origin is None else origin)
        lines.append(f"{seconds:9.3f} s  {entry['kind']:<9} {what(entry)}")
    return "\n".join(lines)


def what(entry: Mapping[str, Any]) -> str:
    """What one entry tells, on one line."""
    if entry.get("terminal"):
        return _end(entry)
    parts = [str(entry[key]) for key in ("state", "event", "why") if entry.get(key)]
    parts += [f"{k}={_short(v)}" for k, v in entry.items() if k not in NOT_SHOWN and v is not None]
    return "  ".join(parts)


def _end(entry: Mapping[str, Any]) -> str:
    """The one terminal entry of a run."""
    text = f"end: {entry.get('outcome')}"
    if entry.get("verdict"):
        text += f", verdict {entry['verdict']}"
    if failure := entry.get("error"):
        text += f", {failure['text']} ({failure['code']})"
    return text


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 3] + "..."
