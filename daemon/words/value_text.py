"""The value of a calibration in a few words: a pose, a crossed-beam reference, a delay."""

from collections.abc import Mapping
from typing import Any

from procedures.kind import KINDS, OUTSIDE, Kind, load
from procedures.words import ms, pose_text


def value_text(name: str, value: Any) -> str:
    """One line."""
    if value is None:
        return "none"
    if isinstance(value, list) and len(value) == 6:
        return pose_text(value)
    if name.startswith("time_offset_s.") and isinstance(value, int | float):
        return ms(value)
    if isinstance(value, Mapping):
        return _document(value)
    return str(value)


def in_a_list(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry of the ledger with a document (a reference is megabytes with its passes) told in a line."""
    if not isinstance(entry["value"], Mapping):
        return dict(entry)
    told = {"schema": entry["value"].get("schema"), "summary": value_text(entry["name"], entry["value"])}
    return {**entry, "value": told}


def _document(value: Mapping[str, Any]) -> str:
    """By the words of the kind that has documents of this schema."""
    schema = str(value.get("schema", "a document"))
    words = _words_of(schema, KINDS)
    if words is None:
        import procedures.registry  # noqa: F401, with it the jobs of installed packages bring their kinds

        words = _words_of(schema, OUTSIDE)
    return f"{schema} with {len(value)} entries" if words is None else str(load(words)(value))


def _words_of(schema: str, kinds: Mapping[str, Kind]) -> str | None:
    return next((words for kind in kinds.values() for name, words in kind.values if name == schema), None)
