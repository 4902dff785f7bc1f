"""``docs/results.md``: every field of every kind of result, from their models."""

import re
from collections.abc import Iterable, Iterator, Mapping
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from cell.errors import error
from cell.formats.result import Envelope, Inputs, Part, Result, Unit
from daemon.docs.page import cell, page
from procedures.kind import KINDS, load

HEAD = """
# Results

Source: the models in `procedures/*/result.py` and `cell/formats/result.py`. Every result is one JSON document
with the schema `cellward.result/1`: `result.json` in a run folder, and what `cellward solve -o` writes.

Keys with a `?` may be absent: the data or the options did not ask for them, or the result is of an earlier
version. `[]` is an entry of a list, `.NAME` one of a table by name. `cov` is 6x6 where nothing else is said:
translation (m) first, then rotation (rad), of a perturbation on the right, `T = T_hat exp(xi)`. Residuals are
no accuracy. When the data cannot determine the answer, `result` is null, `reasons` begins with a fixed name,
and `observability` has it as `refused` with the directions that are missing (`unobservable`, `undetermined`)
and what could not be used (`unusable`). A result that does not fit its model is refused with error 4008; keys
that the model does not have are kept.
"""
Row = tuple[str, str, str]  # key, unit, meaning
BLOCKS = ("result", "uncertainty", "residuals", "heldout", "observability", "inputs")


def results_page() -> str:
    """The text of ``docs/results.md``."""
    lines = ["## Every result", "", *_table(_rows(Envelope)), "", "`inputs` of a run:", ""]
    lines += [*_table(_rows(Inputs)), ""]
    for kind in KINDS.values():
        model: type[Envelope] = load(kind.result)
        if model is Result:
            continue
        lines += [f"## {kind.name}", "", model.__doc__ or "", ""]
        for name in BLOCKS:
            shared = Inputs.model_fields if name == "inputs" else {}
            rows = [
                row
                for row in _rows_of(name, model.model_fields[name], "")
                if len(key := re.split(r"[.?\[]+", row[0])) > 1 and key[1] and key[1] not in shared
            ]
            lines += [f"`{name}`:", "", *_table(rows), ""] if rows else []
    return page(HEAD, lines)


def _table(rows: Iterable[Row]) -> list[str]:
    lines = [f"| `{key}` | {unit} | {cell(meaning)} |" for key, unit, meaning in rows]
    return ["| key | unit | meaning |", "|---|---|---|", *lines]


def _rows(model: type[Part], before: str = "") -> Iterator[Row]:
    for name, field in model.model_fields.items():
        yield from _rows_of(field.alias or name, field, before)


def _rows_of(name: str, field: FieldInfo, before: str) -> Iterator[Row]:
    """A field, and below it those of the tables that it holds."""
    path = f"{before}{name}"
    inside, unit, null = _look(field.annotation)
    unit = next((m.symbol for m in field.metadata if isinstance(m, Unit)), unit)
    optional = "" if field.is_required() or field.default is not None else "?"
    doc = field.description or _first(inside)
    yield path + optional, unit, doc + (" May be null." if null and not optional else "")
    for suffix, model in inside:
        yield from _rows(model, f"{path}{suffix}.")


def _first(inside: list[tuple[str, type[Part]]]) -> str:
    return (inside[0][1].__doc__ or "").split("\n")[0] if inside else ""


def _look(annotation: Any, suffix: str = "") -> tuple[list[tuple[str, type[Part]]], str, bool]:
    """Tables inside an annotation, each with what leads to it; the unit; and whether it may be null."""
    origin, args = get_origin(annotation), get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return [(suffix, annotation)], "", False
    if origin is Annotated:
        inside, unit, null = _look(args[0], suffix)
        return inside, next((m.symbol for m in args[1:] if isinstance(m, Unit)), unit), null
    if origin is Literal or not args:
        return [], "", annotation is type(None)
    if origin in (list, dict, Mapping):
        inside, unit, _ = _look(args[-1], suffix + ("[]" if origin is list else ".NAME"))
        return inside, unit, False
    if origin not in (Union, UnionType):
        raise error("INTERNAL", f"the docs of results do not know an annotation as {annotation}")
    parts = [_look(arg, suffix) for arg in args]
    tables = [table for inside, _, _ in parts for table in inside]
    return tables, next((unit for _, unit, _ in parts if unit), ""), any(null for *_, null in parts)
