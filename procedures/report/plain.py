"""The report of a kind of result that has none of its own: its figures as they are."""

from typing import Any

from procedures.report.html import Html
from procedures.report.layout import Layout, Page
from procedures.report.origin import figures_section, inputs_section
from procedures.report.source import Source
from procedures.report.timeline import timeline_section
from procedures.report.verdict import banner


def _verdict_section(source: Source[Any]) -> Html:
    return banner(source, {}, "Correct what the reason names, and solve again.")


def _plain_page(source: Source[Any]) -> Page[Source[Any]]:
    rest = (timeline_section, inputs_section)
    return Page(top=(_verdict_section, figures_section), left=(), right=(), rest=rest)


PLAIN = Layout(
    source=Source,
    data_file="",
    title=lambda source: f"Result: {source.result.kind}",
    page=_plain_page,
)
