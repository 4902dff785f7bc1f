"""The report of a hand-eye calibration."""

from procedures.hand_eye.report.answer import limits_section, result_section, verdict_section
from procedures.hand_eye.report.budget import budget_section
from procedures.hand_eye.report.checks import (
    consistency_section,
    cross_check_section,
    held_out_section,
    intrinsics_section,
    noise_section,
    observability_section,
)
from procedures.hand_eye.report.comparison import comparison_section
from procedures.hand_eye.report.cover import hand_eye_cover
from procedures.hand_eye.report.residuals import residuals_section
from procedures.hand_eye.report.scene import scene_section, views_section
from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.report.truth import truth_section
from procedures.hand_eye.solve.capture import FILE_NAME
from procedures.report.html import Html
from procedures.report.layout import Layout, Page
from procedures.report.origin import inputs_section
from procedures.report.timeline import events, timeline
from procedures.report.trend import trend_section


def timeline_section(source: HandEyeSource) -> Html | None:
    """The run, with how many poses were taken and skipped."""
    taken = events(source, "pose taken").total()
    skipped = events(source, "pose skipped", "pose failed")
    if skipped:
        words = f"{taken} poses were taken; " + ", ".join(f"{n} times {e}" for e, n in skipped.items())
    else:
        words = f"{taken} poses were taken and none was skipped"
    return timeline(source, words)


def _page(source: HandEyeSource) -> Page[HandEyeSource]:
    """What the data could not determine stands at the top when that is all there is to say."""
    answered = source.found is not None
    return Page(
        top=(verdict_section,),
        left=(result_section, limits_section) if answered else (observability_section,),
        right=(scene_section,),
        rest=(
            views_section,
            budget_section,
            truth_section,
            held_out_section,
            comparison_section,
            residuals_section,
            consistency_section,
            cross_check_section,
            noise_section,
            intrinsics_section,
            *((observability_section,) if answered else ()),
            trend_section,
            timeline_section,
            inputs_section,
        ),
    )


HAND_EYE = Layout(
    source=HandEyeSource,
    data_file=FILE_NAME,
    title=lambda source: f"Hand-eye calibration: camera in {source.parent}",
    page=_page,
    cover=hand_eye_cover,
    shows_truth=True,
)
