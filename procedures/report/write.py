"""From a run folder or a result to one HTML file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import error
from cell.store.files import write_atomic
from procedures.report.answer import result_section, verdict_section
from procedures.report.checks import (
    consistency_section,
    cross_check_section,
    held_out_section,
    intrinsics_section,
    noise_section,
    observability_section,
)
from procedures.report.comparison import comparison_section
from procedures.report.figure import plotly_script
from procedures.report.html import Html, absent, document, el, join
from procedures.report.origin import inputs_section, limits_section
from procedures.report.residuals import residuals_section
from procedures.report.scene import scene_section, views_section
from procedures.report.source import Source, from_folder, from_result
from procedures.report.timeline import timeline_section

FILE_NAME = "report.html"
Section = Callable[[Source], Html | None]
_ANSWERED: tuple[Section, ...] = (result_section, limits_section)
_REFUSED: tuple[Section, ...] = (observability_section,)
_REST: tuple[Section, ...] = (
    views_section,
    held_out_section,
    comparison_section,
    residuals_section,
    consistency_section,
    cross_check_section,
    noise_section,
    intrinsics_section,
    observability_section,
    timeline_section,
    inputs_section,
)


def write_report(
    source: Path | Mapping[str, Any], path: Path | None = None, *, data: Path | None = None
) -> Path:
    """Draw the report of a run folder, or of a result mapping, to ``path``; returns where it is.

    A folder needs ``result.json``; ``capture.json``, ``run.json``, ``journal.jsonl`` and ``end.json`` are
    used when they are there, and ``path`` is ``report.html`` in it unless given. A mapping needs ``path``,
    and ``data`` (a capture data set, or ``inputs.path`` of the result) for what shows poses. A figure whose
    data are absent or damaged is left out and said to be. Raises ``FILE_MISSING`` or ``FILE_UNREADABLE`` for
    the result, ``DISK_FULL`` or ``DISK_FAILED`` for the report.
    """
    if isinstance(source, Path):
        found, path = from_folder(source), path or source / FILE_NAME
    else:
        found = from_result(source, data)
    if path is None:
        raise error("ARGUMENT_INVALID", "a report of a result needs a path to be written to")
    write_atomic(path, render(found))
    return path


def render(source: Source) -> str:
    """The whole file as text."""
    title = _title(source)
    answered = source.answer is not None
    left = _ANSWERED if answered else _REFUSED
    rest = [part for part in _REST if answered or part not in _REFUSED]
    body = join(
        [
            el("header", el("h1", title), el("p", _subtitle(source))),
            _guarded(verdict_section, source),
            el(
                "div",
                el("div", *(_guarded(part, source) for part in left)),
                _guarded(scene_section, source),
                class_="pair",
            ),
            *(_guarded(part, source) for part in rest),
            *(absent(line) for line in source.missing),
            el(
                "footer",
                "Residuals are not accuracy. Cellward supervises and measures; it is not a safety function.",
            ),
        ]
    )
    return document(title, body, plotly_script())


def _guarded(part: Section, source: Source) -> Html | None:
    """A section, or a sentence in its place when what it needs is damaged."""
    try:
        return part(source)
    except (LookupError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as exc:
        name = part.__name__.removesuffix("_section").replace("_", " ")
        return absent(f"The section '{name}' cannot be drawn from this result: {type(exc).__name__}: {exc}")


def _title(source: Source) -> str:
    kind = {"hand-eye": "Hand-eye calibration"}.get(str(source.result.get("kind")), "Result")
    return f"{kind}: camera in {source.parent}"


def _subtitle(source: Source) -> str:
    run = source.run
    if not run:
        return "from a data set"
    cell = run.get("config", {}).get("cell", {}).get("name", "")
    started = str(run.get("started", ""))[:16].replace("T", " ")
    return f"cell {cell} · run {run.get('run_id')} ({run.get('job')}) · {started} UTC"
