"""Results for tests that name only the figures they are about; the rest is that of a stored result."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from cell.formats.result import Envelope, Part
from procedures.documents import read_result

STORED = sorted((Path(__file__).parent / "stored_results").glob("*.json"))


def stored(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return document


def whole(given: Mapping[str, Any]) -> dict[str, Any]:
    """``given`` with every other key that its kind must have; one without an answer stays as it is."""
    if given.get("result") is None:
        return {"reasons": [], "warnings": [], **given}
    return _filled(_example(given["kind"]), given)


def made(given: Mapping[str, Any]) -> Any:
    """``whole`` as the model of its kind."""
    return read_result(whole(given))


@cache
def _example(kind: str) -> Envelope:
    """The stored result of that kind with the most keys."""
    documents = [d for d in map(stored, STORED) if d["kind"] == kind and d["result"] is not None]
    return read_result(max(documents, key=lambda d: len(str(_keys(d)))))


def _keys(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _keys(item) for key, item in value.items()}
    return [_keys(item) for item in value[:1]] if isinstance(value, list) else ""


def _filled(example: Part, given: Mapping[str, Any]) -> dict[str, Any]:
    fields = {field.alias or name: (name, field) for name, field in type(example).model_fields.items()}
    out: dict[str, Any] = {}
    for key, (name, field) in fields.items():
        value = getattr(example, name)
        if key in given:
            nested = isinstance(value, Part) and isinstance(given[key], Mapping)
            out[key] = _filled(value, given[key]) if nested else given[key]
        elif field.is_required():
            out[key] = _filled(value, {}) if isinstance(value, Part) else _plain(value)
        elif field.default is not None:
            out[key] = [] if isinstance(value, list) else value
    return out | {key: value for key, value in given.items() if key not in fields}


def _plain(value: Any) -> Any:
    if isinstance(value, Part):
        return _filled(value, {})
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return {key: _plain(item) for key, item in value.items()} if isinstance(value, dict) else value
