"""Reading a data set from disk: every mistake becomes one sentence with file, field and fix."""

import difflib
import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from cell.errors import error

M = TypeVar("M", bound="Strict")
Table = dict[str, Any]
MAX_BYTES = 200_000_000


class Strict(BaseModel):
    """A table of a file: unknown keys and NaN are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def read_json(path: Path, table: Callable[[Table], Table] | None = None) -> dict[str, Any]:
    """The object in a JSON file; ``FILE_MISSING``, ``FILE_UNREADABLE`` or ``DATA_INVALID`` else.

    ``table``, where given, is told of every table in it, and what it makes of it is taken.
    """
    if not path.is_file():
        raise error("FILE_MISSING", f"{path} does not exist; give the path of a data set")
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise error("FILE_UNREADABLE", f"{path} has {size} bytes, more than the {MAX_BYTES} allowed")
        text = path.read_text("utf-8-sig")  # some editors put a mark before the text
    except (OSError, UnicodeDecodeError) as exc:
        raise error("FILE_UNREADABLE", f"{path} cannot be read ({exc}); replace it with a good copy") from exc
    if not text.strip():
        raise error("FILE_UNREADABLE", f"{path} is empty; replace it with a good copy")
    try:
        made = _once if table is None else lambda pairs: table(_once(pairs))
        raw = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=made)
        if "\\ud" in text or "\\uD" in text:  # an escape that may be half of a pair
            json.dumps(raw, ensure_ascii=False, default=repr).encode()
    except UnicodeEncodeError as exc:
        raise error("DATA_INVALID", f"{path} has half of a character (\\ud800 to \\udfff) in a text") from exc
    except RecursionError as exc:
        raise error("FILE_UNREADABLE", f"{path} is nested too deeply to be a data set") from exc
    except json.JSONDecodeError as exc:
        raise error(
            "FILE_UNREADABLE",
            f"{path} is not JSON: {exc.msg} in line {exc.lineno}, column {exc.colno}; correct or replace it",
        ) from exc
    except ValueError as exc:
        raise error("DATA_INVALID", f"{path} {exc}") from exc
    if not isinstance(raw, dict):
        raise error("DATA_INVALID", f"{path} holds a {type(raw).__name__}; a data set is one JSON object")
    return raw


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"has the key {_short(twice)} twice in one table; keep the right one")
    return table


def _refuse_constant(name: str) -> float:
    raise ValueError(f"holds {name}, which is not a number; write null where a value is missing")


def parse(model: type[M], raw: dict[str, Any], schema: str, where: str) -> M:
    """``raw`` as ``model``. ``schema`` is the one expected, ``where`` names the file in errors."""
    found = raw.get("schema")
    if found != schema:
        was = "has no schema" if found is None else f"has the schema {found!r}"
        raise error("DATA_INVALID", f"{where} {was}; this command reads {schema!r}")
    return parse_part(model, raw, where)


def parse_part(model: type[M], raw: Mapping[str, Any], where: str) -> M:
    """A table without a schema of its own, as ``model``; ``where`` names file and table in errors."""
    try:
        return model.model_validate(raw)
    except ValidationError as exc:
        raise error("DATA_INVALID", f"{where}: {_sentence(exc, model)}") from exc


def _sentence(exc: ValidationError, model: type[BaseModel]) -> str:
    findings = exc.errors(include_url=False)
    first = min(findings, key=lambda e: e["type"] != "extra_forbidden")
    more = f" (and {len(findings) - 1} more findings)" if len(findings) > 1 else ""
    loc, kind, value = path_in(first["loc"], model), first["type"], first.get("input")
    name = str(first["loc"][-1]) if first["loc"] else ""
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(name, _field_names(model), 1, 0.6)
        fix = f"did you mean {near[0]!r}?" if near else "take it out, or put it under 'notes'"
        return f"{loc} is an unknown key; {fix}{more}"
    if kind == "missing":
        return f"{loc} is missing; add it{more}"
    if kind in ("too_short", "too_long"):
        limits = first.get("ctx", {})
        wanted = limits.get("min_length", limits.get("max_length"))
        bound = "at least" if kind == "too_short" else "at most"
        return f"{loc} has {limits.get('actual_length')} entries; it must have {bound} {wanted}{more}"
    text = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
    return f"{loc} {text[:1].lower() + text[1:]}, found {_short(value)}{more}"


def _short(value: object) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "a number that is not finite"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def path_in(loc: Iterable[str | int], model: type[BaseModel]) -> str:
    """``observations[3].T_base_flange``; the tags that pydantic adds for unions are left out."""
    names = _field_names(model)
    parts = list(loc)
    text = ""
    for k, part in enumerate(parts):
        if isinstance(part, int):
            text += f"[{part}]"
        elif k == len(parts) - 1 or part in names:
            text += f".{part}" if text else part
    return text or "the data set"


def _field_names(model: type[BaseModel], seen: set[type[BaseModel]] | None = None) -> set[str]:
    """Names of all keys of a model and of the tables inside it."""
    seen = set() if seen is None else seen
    if model in seen:
        return set()
    seen.add(model)
    names = set(model.model_fields)
    stack: list[Any] = [f.annotation for f in model.model_fields.values()]
    while stack:
        annotation = stack.pop()
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            names |= _field_names(annotation, seen)
        stack.extend(getattr(annotation, "__args__", ()))
    return names
