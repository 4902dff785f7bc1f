"""The value of a calibration in a few words: a pose, a crossed-beam reference, a delay."""

from collections.abc import Mapping
from typing import Any

from procedures.words import mm, ms, pose_text, told


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
    if value.get("schema") == "cellward.kinematics/1":
        return _arm(value)
    if value.get("schema") not in ("cellward.laser-reference/1", "cellward.laser-reference/2"):
        return f"{value.get('schema', 'a document')} with {len(value)} entries"
    tool, hits = value.get("tool") or {}, value.get("hits") or {}
    at = ", ".join(f"{beam} [{_point(p)}] mm" for beam, p in hits.items() if p is not None)
    passes = len(value.get("passes") or [])
    text = f"tool {tool.get('id')}, flange at the beams {at or 'unknown'}, {passes} passes"
    return f"{text}, delay {ms(value['tau_s'])}" if value.get("tau_s") is not None else text


def _arm(value: Mapping[str, Any]) -> str:
    before, after = mm(value.get("rms_registration_only")), mm(value.get("rms_calibrated"), 4)
    return (
        f"calibrated arm, {before} off before and {after} after (RMS of {told(value.get('held_out'))} poses "
        f"that were held out), 95 % of errors below {mm(value.get('predicted_95'), 4)}, payload "
        f"{told(value.get('payload_kg'), 'g')} kg"
    )


def _point(p: Any) -> str:
    return ", ".join(f"{1e3 * v:.3f}" for v in p)
