"""From a run folder or a result to one HTML file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import CellError, error
from cell.formats.result import Envelope, Result, read_as
from cell.store.files import write_atomic
from procedures.documents import kind_of, read_result
from procedures.kind import load
from procedures.report.cover import cover, is_twin
from procedures.report.figure import plotly_script
from procedures.report.html import Html, absent, document, el, join
from procedures.report.layout import Layout, Section
from procedures.report.plain import PLAIN
from procedures.report.source import RESULT_FILE, Source, of_folder, read_document

FILE_NAME = "report.html"


def write_report(
    source: Path | Mapping[str, Any],
    path: Path | None = None,
    *,
    data: Path | None = None,
    decided: Sequence[Mapping[str, Any]] = (),
) -> Path:
    """Draw the report of a run folder, or of a result mapping, to ``path``; returns where it is.

    A folder needs ``result.json``; its data set, ``run.json``, ``journal.jsonl`` and ``end.json`` are used
    when they are there, and ``path`` is ``report.html`` in it unless given. A mapping needs ``path``, and
    ``data`` (a data set, or ``inputs.path`` of the result) for what shows measurements. ``decided`` are the
    ledger's rows about results of the run. A figure whose data
    are absent or damaged is left out and said to be. Raises ``FILE_MISSING`` or ``FILE_UNREADABLE`` for
    the result, ``KIND_UNKNOWN`` for its kind, ``DISK_FULL`` or ``DISK_FAILED`` for the report.
    """
    if isinstance(source, Path):
        found, path = from_folder(source), path or source / FILE_NAME
    else:
        found = from_result(source, data)
    found.decided = decided
    if path is None:
        raise error("ARGUMENT_INVALID", "a report of a result needs a path to be written to")
    write_atomic(path, render(found))
    return path


def from_folder(folder: Path) -> Source[Any]:
    """A run folder as the sections of its kind want it."""
    document = read_document(folder)
    layout = layout_of(document)
    result, misfit = _read(document, str(folder / RESULT_FILE))
    source: Source[Any] = of_folder(Source if misfit else layout.source, result, folder, layout.data_file)
    source.misfit = misfit
    return source


def from_result(document: Mapping[str, Any], data: Path | None) -> Source[Any]:
    """A result alone; its data set is ``data``, or what ``inputs.path`` names."""
    layout = layout_of(document)
    result, misfit = _read(document, "the result")
    named = getattr(result.made_from(), "path", None)
    if data is None and isinstance(named, str):
        data = Path(named)
    source: Source[Any] = Source(result, data) if misfit else layout.source(result, data)
    source.misfit = misfit
    return source


def _read(document: Mapping[str, Any], where: str) -> tuple[Envelope, str]:
    """The result, and why it does not fit the model of its kind; it has its figures all the same then."""
    try:
        return read_result(document, where), ""
    except CellError as exc:
        if exc.name != "RESULT_INVALID":
            raise
        return read_as(Result, document, where), str(exc)


def render(source: Source[Any]) -> str:
    """The whole file as text."""
    layout = PLAIN if source.misfit else layout_of({"kind": source.result.kind})
    title, page = layout.title(source), layout.page(source)
    columns = [el("div", *(_guarded(part, source) for part in parts)) for parts in (page.left, page.right)]

    def cover_section(source: Source[Any]) -> Html:
        return cover(source, layout.cover(source))

    body = join(
        [
            el("header", el("h1", title), el("p", subtitle(source))),
            _guarded(cover_section, source),
            *(_guarded(part, source) for part in page.top),
            el("div", *columns, class_="pair"),
            *(_guarded(part, source) for part in page.rest),
            absent(f"Shown as plain figures: {source.misfit}") if source.misfit else None,
            *(absent(line) for line in source.missing),
            el(
                "footer",
                "Residuals are not accuracy. Cellward supervises and measures; it is not a safety function.",
            ),
        ]
    )
    return document(titled(title, source), body, plotly_script(), running=subtitle(source))


def titled(title: str, source: Source[Any]) -> str:
    """The name of the page, which says that the cell was simulated if it was."""
    return f"TWIN: {title}" if is_twin(source) else title


def layout_of(result: Mapping[str, Any]) -> Layout[Any]:
    """The layout for ``result``; ``KIND_UNKNOWN`` for one of a kind that is not known."""
    found: Layout[Any] = load(kind_of(result).report)
    return found


def _guarded(part: Section[Any], source: Source[Any]) -> Html | None:
    """A section, or a sentence in its place when what it needs is damaged."""
    try:
        return part(source)
    except (LookupError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as exc:
        name = part.__name__.removesuffix("_section").replace("_", " ")
        return absent(f"The section '{name}' cannot be drawn from this result: {type(exc).__name__}: {exc}")


def subtitle(source: Source[Any]) -> str:
    """Cell, run, job and start in one line."""
    run = source.run
    if not run:
        return "from a data set"
    cell = run.get("config", {}).get("cell", {}).get("name", "")
    started = str(run.get("started", ""))[:16].replace("T", " ")
    return f"cell {cell} · run {run.get('run_id')} ({run.get('job')}) · {started} UTC"
