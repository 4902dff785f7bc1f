"""The report of a kind of result that has no sections of its own: its figures in words, or as they are."""

from collections.abc import Callable
from typing import Any

from cell.errors import CellError
from procedures.documents import kind_of
from procedures.kind import load
from procedures.report.cover import Cover
from procedures.report.html import Html, el, section
from procedures.report.layout import Layout, Page
from procedures.report.origin import figures_section, inputs_section
from procedures.report.source import Source
from procedures.report.timeline import timeline_section
from procedures.report.verdict import banner


def _verdict_section(source: Source[Any]) -> Html:
    return banner(source, {}, "Correct what the reason names, and solve again.")


def words_section(source: Source[Any]) -> Html:
    """The answer as 'cellward show' tells it; a kind without words, or a misfit, as it stands in the file."""
    try:
        words = load(kind_of({"kind": source.result.kind}).words)
    except (CellError, ImportError, AttributeError, ValueError):
        return figures_section(source)
    if source.found is None:
        return figures_section(source)
    lines = "\n".join(words(source.found))
    return section("The result", el("pre", lines, class_="words"))


def _page(_source: Source[Any]) -> Page[Source[Any]]:
    rest = (timeline_section, inputs_section)
    return Page(top=(_verdict_section, words_section), left=(), right=(), rest=rest)


def in_words(title: str, cover: Callable[[Source[Any]], Cover], data_file: str) -> Layout[Source[Any]]:
    """The report of a kind that has a first page and nothing to draw."""
    return Layout(source=Source, data_file=data_file, title=lambda _source: title, page=_page, cover=cover)


PLAIN = Layout(
    source=Source,
    data_file="",
    title=lambda source: f"Result: {source.result.kind}",
    page=_page,
)
