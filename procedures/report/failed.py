"""The report of a run without a result: why it ended, what was taken again, and its last journal entries."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.formats.result import Result
from cell.store.files import write_atomic
from procedures.report.cover import Cover, cover, stopped_by
from procedures.report.figure import plotly_script
from procedures.report.html import Html, bullets, document, el, join, note, paragraph, section, table
from procedures.report.last_seconds import last_seconds_section
from procedures.report.numbers import DASH, dig, number
from procedures.report.source import Source, of_folder
from procedures.report.timeline import timeline
from procedures.report.write import FILE_NAME, subtitle, titled

MOST_ENTRIES = 30
NO_RESULT = Result(kind="", verdict="fail", result=None)


def write_failed_report(folder: Path, path: Path | None = None) -> Path:
    """Draw the report of a run folder that has no ``result.json``; returns where it is.

    A journal, ``run.json`` or ``end.json`` that is missing or damaged is said to be. ``DISK_FULL``,
    ``DISK_FAILED``.
    """
    path = path or folder / FILE_NAME
    source = of_folder(Source, NO_RESULT, folder, "")
    run = source.run
    outcome = source.end.get("outcome") or "has no end: it goes on, or was interrupted"
    how = f"ended {outcome}" if source.end else outcome
    title = f"Run {run.get('run_id', folder.name)} ({run.get('job', 'unknown job')}) {how}, without a result"
    early = "" if source.end else ". The report was drawn before the run had ended"
    count = len(source.journal)
    shown = f"The last {min(count, MOST_ENTRIES)} of {count} entries of the journal{early}"
    body = join(
        [
            el("header", el("h1", title), el("p", subtitle(source))),
            cover(source, Cover()),
            _cause(source),
            _timing(source),
            _taken_again(source),
            last_seconds_section(folder),
            timeline(source, shown, routine=True, newest=MOST_ENTRIES),
            *(paragraph(line) for line in source.missing),
        ]
    )
    write_atomic(path, document(titled(title, source), body, plotly_script(), running=subtitle(source)))
    return path


def _cause(source: Source[Any]) -> Html:
    """State, cause, code and hint. Ages of samples and lags of the loop are in the error's own sentence."""
    failure = source.end.get("error")
    state = source.end.get("packml")
    last = next((e["state"] for e in reversed(source.journal) if isinstance(e.get("state"), str)), None)
    where = [f"The job was in the state {last}."] if last else []
    where += [f"The cell ended in {state}."] if state else []
    if not isinstance(failure, Mapping):
        why = stopped_by(source)
        told = f"The run was {why}" if why else "No error was recorded."
        return section("Why", paragraph(told), note(" ".join(where)))
    return section(
        "Why",
        paragraph(f"{failure.get('text')} (code {failure.get('code')}, {failure.get('name')})"),
        paragraph(str(failure.get("hint") or "")),
        note(" ".join(where)),
    )


def _timing(source: Source[Any]) -> Html | None:
    """How late the event loop woke and how old the arm's states were: whether a busy PC is to blame."""
    told = [e for e in source.journal if e.get("event") == "timing"]
    if not told:
        return None
    rows = [
        (words, *(_milliseconds(dig(told[-1], key, which)) for which in ("p99_s", "max_s")))
        for key, words in (
            ("loop_lag", "the event loop woke late by"),
            ("state_age", "the arm's states were old by"),
        )
        if number(dig(told[-1], key, "n"))
    ]
    if not rows:
        return None
    return section("How timely it was", table(("", "99 of 100 below", "largest"), rows, "lrr"))


def _milliseconds(seconds: object) -> str:
    value = number(seconds)
    return DASH if value is None else f"{1e3 * value:.1f} ms"


def _taken_again(source: Source[Any]) -> Html | None:
    """The short silences of devices before the end."""
    silences = [e for e in source.journal if e.get("event") in ("interrupted", "interrupted too often")]
    return section("Short silences of devices", bullets(_told(e) for e in silences)) if silences else None


def _told(entry: Mapping[str, Any]) -> str:
    why = entry.get("why") or entry.get("text")
    ended = "; too many, the run ended" if entry["event"] == "interrupted too often" else ""
    return f"{entry.get('step')}: {why}{ended}"
