"""What everybody reads of ``run.json`` and ``end.json``, and which types it has there.

A plain table and not a model: listing the runs reads these files by the hundred and imports nothing for it.
"""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

RUN_FIELDS: Mapping[str, Any] = {"started": str | None, "parameters": dict | None}
END_FIELDS: Mapping[str, Any] = {
    "ended": str | None,
    "outcome": str,
    "packml": str | None,
    "verdict": str | None,
    "result_sha256": str | None,
    "figure": dict | None,
    "error": dict | None,
}
_STAMPS = ("started", "ended")
_NAMES = {str: "text", dict: "an object", str | None: "text", dict | None: "an object"}


def misfit(fields: Mapping[str, Any], content: Mapping[str, Any]) -> str | None:
    """The first field that is not what it is written as, in words; None when all fit."""
    for name, kind in fields.items():
        value = content.get(name)
        if not isinstance(value, kind):
            return f"'{name}' should be {_NAMES[kind]}"
        if name in _STAMPS and value is not None and not _is_stamp(value):
            return f"'{name}' should be a date and time"
    return None


def tool_on_flange(info: Mapping[str, Any]) -> str | None:
    """The name of the tool that a run worked with, by its ``run.json``; None where it says none."""
    values = info.get("values")
    tool = values.get("tool") if isinstance(values, Mapping) else None
    name = tool.get("name") if isinstance(tool, Mapping) else None
    return name if isinstance(name, str) else None


def _is_stamp(text: str) -> bool:
    try:
        datetime.fromisoformat(text)
    except ValueError:
        return False
    return True
