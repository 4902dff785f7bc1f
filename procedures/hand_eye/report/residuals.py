"""Residuals of each pose, and the list of those that were not used, each with its reason."""

from collections.abc import Callable
from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from procedures.hand_eye.report.checks import pair
from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.result import HandEyeResiduals, ObservationResidual
from procedures.report.figure import REJECTED, colour, dots, dressed, embed, label
from procedures.report.html import Html, el, facts, note, section, table
from procedures.report.numbers import DASH, deg, mm, px

_ROWS: tuple[tuple[Callable[[ObservationResidual], float | None], str, float], ...] = (
    (lambda e: e.t, "position, mm", 1e3),
    (lambda e: e.r, "rotation, °", 180.0 / np.pi),
    (lambda e: e.reprojection_px, "reprojection, px", 1.0),
)


def residuals_section(source: HandEyeSource) -> Html | None:
    """Three figures over the number of the observation, and the summary figures in words."""
    if source.found is None:
        return None
    residuals, frame = source.found.residuals, source.target_parent
    return section(
        "Residuals of each pose",
        note(
            f"Top and middle: distance of the target's pose in the {frame}, as this pose alone sees it, from "
            "the mean of its placement. Bottom: how well the corners of one image fit a pose of their own. "
            "A dot was used, a red cross was not. Hover for reasons."
        ),
        embed(_figure(residuals.per_observation, source.rejected), "residuals"),
        facts(_summary(residuals, frame)),
        _rejected_table(source),
    )


def _figure(entries: list[ObservationResidual], rejected: dict[int, str]) -> Any:
    groups = sorted({e.group for e in entries})
    fig = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.05)
    dressed(fig, 470)
    for row, (value, title, scale) in enumerate(_ROWS, start=1):
        for group in groups:
            mine = [e for e in entries if e.group == group]
            tint, name = colour(groups, group), f"placement {group + 1}"
            used = [e for e in mine if e.used]
            fig.add_trace(_trace(used, value, scale, tint, name, rejected, row == 1), row, 1)
        left_out = [e for e in entries if not e.used]
        if left_out:
            fig.add_trace(_trace(left_out, value, scale, REJECTED, "not used", rejected, row == 1), row, 1)
        fig.update_yaxes(title_text=title, rangemode="tozero", row=row, col=1)
    fig.update_xaxes(title_text="number of the observation", row=3, col=1)
    return fig


def _trace(
    entries: list[ObservationResidual],
    value: Callable[[ObservationResidual], float | None],
    scale: float,
    tint: str,
    name: str,
    rejected: dict[int, str],
    legend: bool,
) -> Any:
    values = [value(e) for e in entries]
    texts = [_hover(e, rejected) for e in entries]
    return dots(
        [e.index for e in entries],
        [None if v is None else v * scale for v in values],
        tint,
        "%{text}",
        size=8,
        symbol="x" if name == "not used" else "circle",
        name=name,
        legendgroup=name,
        showlegend=legend,
        text=texts,
    )


def _hover(entry: ObservationResidual, rejected: dict[int, str]) -> str:
    lines = [
        f"observation {entry.index}",
        f"{mm(entry.t)}, {deg(entry.r)}, {px(entry.reprojection_px)}",
        f"{DASH if entry.corners is None else entry.corners} corners",
    ]
    why = rejected.get(entry.index)
    return "<br>".join([*lines, label(why)] if why else lines)


def _summary(found: HandEyeResiduals, frame: str) -> list[tuple[str, object, str]]:
    rows: list[tuple[str, object, str]] = [
        (
            "Mean distance, used poses",
            pair(found.spread_mean),
            f"Mean distance of the target's poses in the {frame} from their mean. A residual: it tells how "
            "well the poses agree with each other, not how accurate the result is.",
        ),
        (
            "Mean distance, all poses",
            pair(found.spread_mean_all),
            "The same with the poses that were left out.",
        ),
    ]
    for name, value, meaning in (
        (
            "Reprojection, each image alone",
            found.reprojection_rms_px,
            "How well a free pose explains the corners of an image: detector and lens, not the arm.",
        ),
        (
            "Reprojection through the arm",
            found.reprojection_through_arm_rms_px,
            "The same with the pose that arm, result and target pose predict: it holds the arm's errors as "
            "well.",
        ),
    ):
        if value is not None:
            rows.append((name, px(value) + " RMS", meaning))
    return rows


def _rejected_table(source: HandEyeSource) -> Html:
    rejected = source.rejected
    if not rejected:
        return note("Every observation was used.")
    rows = [(index, reason) for index, reason in sorted(rejected.items())]
    return Html(el("h3", "Observations that were not used") + table(("number", "why"), rows))
