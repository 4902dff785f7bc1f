"""Every figure of a result as one line of CSV: key, value, unit and meaning, for a table calculation."""

import csv
import io
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic.fields import FieldInfo

from cell.formats.result import Envelope, Part, Unit

FILE_NAME = "figures.csv"
COLUMNS = ("key", "value", "unit", "meaning")
Row = tuple[str, Any, str, str]


def figures_csv(result: Envelope) -> str:
    """The text of the file. Keys are those of ``result.json`` and of the manual's page of results, with the
    place in a list in brackets; values are in SI with all their digits, and what is null is empty."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(COLUMNS)
    lines.writerows(figure_rows(result))
    return text.getvalue()


def figure_rows(part: Part, before: str = "") -> Iterator[Row]:
    """Key, value (SI), unit and meaning of everything in it."""
    for name, field in type(part).model_fields.items():
        if name in part.model_fields_set or field.is_required():
            yield from _of(before + (field.alias or name), getattr(part, name), _unit(field), field)
    for name, value in (part.model_extra or {}).items():
        yield from _of(before + name, value, "", None)


def _of(key: str, value: Any, unit: str, field: FieldInfo | None) -> Iterator[Row]:
    if isinstance(value, Part):
        yield from figure_rows(value, f"{key}.")
    elif isinstance(value, Mapping):
        for name, inside in value.items():
            yield from _of(f"{key}.{name}", inside, unit, field)
    elif isinstance(value, list | tuple):
        for place, inside in enumerate(value):
            yield from _of(f"{key}[{place}]", inside, unit, field)
    else:
        shown = str(value).lower() if isinstance(value, bool) else value
        yield key, shown, unit, (field.description or "") if field is not None else ""


def _unit(field: FieldInfo) -> str:
    own = (m.symbol for m in field.metadata if isinstance(m, Unit))
    return next(own, "") or _inside(field.annotation)


def _inside(annotation: Any) -> str:
    """The unit of what a list, a table or an optional holds; a table of its own has units of its own."""
    if isinstance(annotation, Unit):
        return annotation.symbol
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return ""
    return next((unit for arg in get_args(annotation) if (unit := _inside(arg))), "")
