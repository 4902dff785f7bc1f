"""Residuals of each pose, and the list of those that were not used, each with its reason."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from procedures.hand_eye.report.scene import rejected_of
from procedures.hand_eye.report.source import HandEyeSource
from procedures.report.figure import REJECTED, colour, dressed, embed, label
from procedures.report.html import Html, absent, el, facts, note, section, table
from procedures.report.numbers import deg, dig, mm, number, px

_ROWS = (
    ("t", "position, mm", 1e3),
    ("r", "rotation, °", 180.0 / np.pi),
    ("reprojection_px", "reprojection, px", 1.0),
)


def residuals_section(source: HandEyeSource) -> Html | None:
    """Three figures over the number of the observation, and the summary figures in words."""
    if source.answer is None:
        return None
    rows = dig(source.result, "residuals", "per_observation")
    entries = [r for r in rows if isinstance(r, Mapping)] if isinstance(rows, list) else []
    frame = source.target_parent
    drawn: Html = (
        embed(_figure(entries, rejected_of(source)), "residuals")
        if entries
        else absent("The result has no residuals of single observations.")
    )
    return section(
        "Residuals of each pose",
        note(
            f"Top and middle: distance of the target's pose in the {frame}, as this pose alone sees it, from "
            "the mean of its placement. Bottom: how well the corners of one image fit a pose of their own. "
            "A dot was used, a red cross was not. Hover for reasons."
        ),
        drawn,
        facts(_summary(source)),
        _rejected_table(source),
    )


def _figure(entries: list[Mapping[str, Any]], rejected: dict[int, str]) -> Any:
    groups = sorted({int(e.get("group") or 0) for e in entries})
    fig = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.05)
    dressed(fig, 470)
    for row, (key, title, scale) in enumerate(_ROWS, start=1):
        for group in groups:
            mine = [e for e in entries if int(e.get("group") or 0) == group]
            tint, name = colour(groups, group), f"placement {group + 1}"
            used = [e for e in mine if e.get("used")]
            fig.add_trace(_trace(used, key, scale, tint, name, rejected, row == 1), row, 1)
        left_out = [e for e in entries if not e.get("used")]
        if left_out:
            fig.add_trace(_trace(left_out, key, scale, REJECTED, "not used", rejected, row == 1), row, 1)
        fig.update_yaxes(title_text=title, rangemode="tozero", row=row, col=1)
    fig.update_xaxes(title_text="number of the observation", row=3, col=1)
    return fig


def _trace(
    entries: list[Mapping[str, Any]],
    key: str,
    scale: float,
    tint: str,
    name: str,
    rejected: dict[int, str],
    legend: bool,
) -> Any:
    values = [number(e.get(key)) for e in entries]
    texts = [_hover(e, rejected) for e in entries]
    return go.Scatter(
        x=[e.get("index") for e in entries],
        y=[None if v is None else v * scale for v in values],
        mode="markers",
        marker={"color": tint, "size": 8, "symbol": "x" if name == "not used" else "circle"},
        name=name,
        legendgroup=name,
        showlegend=legend,
        text=texts,
        hovertemplate="%{text}<extra></extra>",
    )


def _hover(entry: Mapping[str, Any], rejected: dict[int, str]) -> str:
    index = entry.get("index")
    lines = [
        f"observation {label(index)}",
        f"{mm(entry.get('t'))}, {deg(entry.get('r'))}, {px(entry.get('reprojection_px'))}",
        f"{label(entry.get('corners'))} corners",
    ]
    why = rejected.get(index) if isinstance(index, int) else None
    return "<br>".join([*lines, label(why)] if why else lines)


def _summary(source: HandEyeSource) -> list[tuple[str, object, str]]:
    found = source.result.get("residuals")
    frame = source.target_parent
    rows: list[tuple[str, object, str]] = []
    for key, name, meaning in (
        (
            "spread_mean",
            "Mean distance, used poses",
            f"Mean distance of the target's poses in the {frame} from their mean. A residual: it tells how "
            "well the poses agree with each other, not how accurate the result is.",
        ),
        ("spread_mean_all", "Mean distance, all poses", "The same with the poses that were left out."),
    ):
        if (value := dig(found, key)) is not None:
            rows.append((name, _pair(value), meaning))
    for key, name, meaning in (
        (
            "reprojection_rms_px",
            "Reprojection, each image alone",
            "How well a free pose explains the corners of an image: detector and lens, not the arm.",
        ),
        (
            "reprojection_through_arm_rms_px",
            "Reprojection through the arm",
            "The same with the pose that arm, result and target pose predict: it holds the arm's errors as "
            "well.",
        ),
    ):
        if (value := dig(found, key)) is not None:
            rows.append((name, px(value) + " RMS", meaning))
    return rows


def _pair(value: Any) -> str:
    return f"{mm(dig(value, 't'))}, {deg(dig(value, 'r'))}"


def _rejected_table(source: HandEyeSource) -> Html:
    rejected = rejected_of(source)
    if not rejected:
        return note("Every observation was used.")
    rows = [(index, reason) for index, reason in sorted(rejected.items())]
    return Html(el("h3", "Observations that were not used") + table(("number", "why"), rows))
