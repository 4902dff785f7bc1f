"""The report of a kinematic calibration: how far the arm was off, and how far it is off now."""

from procedures.report.layout import Layout, Page
from procedures.report.numbers import dig
from procedures.report.origin import inputs_section
from procedures.report.timeline import timeline_section
from procedures.report.trend import trend_section
from procedures.tracker.report.answer import figures_section, place_section, verdict_section
from procedures.tracker.report.cover import kincal_cover
from procedures.tracker.report.map import map_section
from procedures.tracker.report.open import parameters_section, rank_section, rule_section
from procedures.tracker.report.residuals import before_section, residuals_section
from procedures.tracker.report.run import aside_section, limits_section, monuments_section
from procedures.tracker.report.source import KincalSource
from procedures.tracker.report.space import space_section
from procedures.tracker.solve.data import FILE_NAME


def _title(source: KincalSource) -> str:
    robot = getattr(source.result.made_from(), "robot", None)
    name = dig(robot, "model") or dig(robot, "family")
    return "Kinematic calibration" if name is None else f"Kinematic calibration: {name}"


def _page(_source: KincalSource) -> Page[KincalSource]:
    """What the calibration came to first; then where it holds, and what it is made of."""
    return Page(
        top=(verdict_section, before_section),
        left=(figures_section, aside_section, limits_section, rule_section),
        right=(rank_section, place_section),
        rest=(
            map_section,
            monuments_section,
            space_section,
            residuals_section,
            parameters_section,
            trend_section,
            timeline_section,
            inputs_section,
        ),
    )


KINCAL = Layout(source=KincalSource, data_file=FILE_NAME, title=_title, page=_page, cover=kincal_cover)
