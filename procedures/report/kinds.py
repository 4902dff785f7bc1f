"""Which layout the report of a result has, by the result's ``kind``."""

from collections.abc import Mapping
from typing import Any

from procedures.report.belt import BELT_TRACKING
from procedures.report.belt_calibration import BELT_CALIBRATION
from procedures.report.hand_eye import HAND_EYE
from procedures.report.html import Html
from procedures.report.iso9283 import ISO9283
from procedures.report.kincal import KINCAL
from procedures.report.laser import LASER
from procedures.report.layout import Layout, Page
from procedures.report.origin import figures_section, inputs_section
from procedures.report.source import Source
from procedures.report.timeline import timeline_section
from procedures.report.verdict import banner


def _verdict_section(source: Source) -> Html:
    return banner(source, {}, "Correct what the reason names, and solve again.")


def _plain_page(source: Source) -> Page[Source]:
    rest = (timeline_section, inputs_section)
    return Page(top=(_verdict_section, figures_section), left=(), right=(), rest=rest)


PLAIN = Layout(
    source=Source,
    data_file="",
    title=lambda source: f"Result: {source.result.get('kind')}",
    page=_plain_page,
)
LAYOUTS: dict[str, Layout[Any]] = {
    "belt-calibration": BELT_CALIBRATION,
    "belt-tracking": BELT_TRACKING,
    "hand-eye": HAND_EYE,
    "iso9283": ISO9283,
    "kincal": KINCAL,
    "laser": LASER,
    "laser-reference": LASER,
}


def layout_of(result: Mapping[str, Any]) -> Layout[Any]:
    """The layout for ``result``; one of a kind that is not known here is shown as plain figures."""
    return LAYOUTS.get(str(result.get("kind")), PLAIN)
