"""The value of a calibration in a few words: a pose, a crossed-beam reference, a delay."""

from collections.abc import Mapping
from typing import Any

from procedures.kind import KINDS, OUTSIDE, load
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
    for kind in (*KINDS.values(), *OUTSIDE.values()):
        for name, words in kind.values:
            if name == schema:
                return str(load(words)(value))
    return f"{schema} with {len(value)} entries"
