"""From a run folder or a result to one HTML file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import error
from cell.store.files import write_atomic
from procedures.kind import kind_of, load
from procedures.report.figure import plotly_script
from procedures.report.html import Html, absent, document, el, join
from procedures.report.layout import Layout, Section
from procedures.report.numbers import dig
from procedures.report.source import Source, of_folder, read_result

FILE_NAME = "report.html"


def write_report(
    source: Path | Mapping[str, Any], path: Path | None = None, *, data: Path | None = None
) -> Path:
    """Draw the report of a run folder, or of a result mapping, to ``path``; returns where it is.

    A folder needs ``result.json``; its data set, ``run.json``, ``journal.jsonl`` and ``end.json`` are used
    when they are there, and ``path`` is ``report.html`` in it unless given. A mapping needs ``path``, and
    ``data`` (a data set, or ``inputs.path`` of the result) for what shows measurements. A figure whose data
    are absent or damaged is left out and said to be. Raises ``FILE_MISSING`` or ``FILE_UNREADABLE`` for
    the result, ``KIND_UNKNOWN`` for its kind, ``DISK_FULL`` or ``DISK_FAILED`` for the report.
    """
    if isinstance(source, Path):
        found, path = from_folder(source), path or source / FILE_NAME
    else:
        found = from_result(source, data)
    if path is None:
        raise error("ARGUMENT_INVALID", "a report of a result needs a path to be written to")
    write_atomic(path, render(found))
    return path


def from_folder(folder: Path) -> Source:
    """A run folder as the sections of its kind want it."""
    result = read_result(folder)
    layout = layout_of(result)
    source: Source = of_folder(layout.source, result, folder, layout.data_file)
    return source


def from_result(result: Mapping[str, Any], data: Path | None) -> Source:
    """A result alone; its data set is ``data``, or what ``inputs.path`` names."""
    named = dig(result, "inputs", "path")
    if data is None and isinstance(named, str):
        data = Path(named)
    source: Source = layout_of(result).source(result, data)
    return source


def render(source: Source) -> str:
    """The whole file as text."""
    layout = layout_of(source.result)
    title, page = layout.title(source), layout.page(source)
    columns = [el("div", *(_guarded(part, source) for part in parts)) for parts in (page.left, page.right)]
    body = join(
        [
            el("header", el("h1", title), el("p", subtitle(source))),
            *(_guarded(part, source) for part in page.top),
            el("div", *columns, class_="pair"),
            *(_guarded(part, source) for part in page.rest),
            *(absent(line) for line in source.missing),
            el(
                "footer",
                "Residuals are not accuracy. Cellward supervises and measures; it is not a safety function.",
            ),
        ]
    )
    return document(title, body, plotly_script())


def layout_of(result: Mapping[str, Any]) -> Layout[Any]:
    """The layout for ``result``; ``KIND_UNKNOWN`` for one of a kind that is not known."""
    found: Layout[Any] = load(kind_of(result).report)
    return found


def _guarded(part: Section[Any], source: Source) -> Html | None:
    """A section, or a sentence in its place when what it needs is damaged."""
    try:
        return part(source)
    except (LookupError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as exc:
        name = part.__name__.removesuffix("_section").replace("_", " ")
        return absent(f"The section '{name}' cannot be drawn from this result: {type(exc).__name__}: {exc}")


def subtitle(source: Source) -> str:
    """Cell, run, job and start in one line."""
    run = source.run
    if not run:
        return "from a data set"
    cell = run.get("config", {}).get("cell", {}).get("name", "")
    started = str(run.get("started", ""))[:16].replace("T", " ")
    return f"cell {cell} · run {run.get('run_id')} ({run.get('job')}) · {started} UTC"
