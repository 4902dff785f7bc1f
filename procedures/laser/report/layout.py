"""The report of a crossed-beam measurement: of a reference, or of a tool against its reference."""

from procedures.laser.report.answer import result_section, verdict_section
from procedures.laser.report.checks import figures_section, held_out_section, open_section
from procedures.laser.report.cover import laser_cover
from procedures.laser.report.edges import edges_section, residuals_section
from procedures.laser.report.heights import heights_section
from procedures.laser.report.limits import limits_section
from procedures.laser.report.out_and_back import out_and_back_section
from procedures.laser.report.second import second_section
from procedures.laser.report.source import LaserSource
from procedures.laser.report.tool import tool_section
from procedures.laser.solve.data import FILE_NAME
from procedures.report.html import Html
from procedures.report.layout import Layout, Page
from procedures.report.origin import inputs_section
from procedures.report.timeline import events, timeline
from procedures.report.trend import trend_section


def timeline_section(source: LaserSource) -> Html | None:
    """The run, with how many ways could not be used."""
    unused = events(source, "pass not used").total()
    words = {0: "Every pass could be used", 1: "One pair of passes could not be used"}
    return timeline(source, words.get(unused, f"{unused} pairs of passes could not be used"))


def _title(source: LaserSource) -> str:
    what = "Crossed-beam reference" if source.is_reference else "Tool in the crossed beams"
    return what if source.tool_id is None else f"{what}: {source.tool_id}"


def _page(source: LaserSource) -> Page[LaserSource]:
    """The numbers and the picture of the tool first; then the edges that they come from."""
    made = source.is_reference
    return Page(
        top=(verdict_section, tool_section),
        left=(result_section,) if made else (result_section, limits_section, held_out_section),
        right=(limits_section, figures_section) if made else (figures_section, second_section),
        rest=(
            edges_section,
            residuals_section,
            heights_section,
            out_and_back_section,
            trend_section,
            open_section,
            timeline_section,
            inputs_section,
        ),
    )


LASER = Layout(source=LaserSource, data_file=FILE_NAME, title=_title, page=_page, cover=laser_cover)
