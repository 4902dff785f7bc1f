"""The report of an eye-to-hand check: the verdict, the map of the workspace, and what correcting brings."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cell.poses import Array
from procedures.eye_to_hand.report.cover import axbc_cover
from procedures.eye_to_hand.result import AxbcAnswer, AxbcResult
from procedures.eye_to_hand.solve.data import FILE_NAME
from procedures.eye_to_hand.words import BLAMED, WAYS, gain_text, seen_text, shift_lines
from procedures.report.figure import BEFORE, NOW, dressed, embed, figure, polyline
from procedures.report.html import Html, el, facts, note, section, table
from procedures.report.layout import Layout, Page
from procedures.report.numbers import deg, mm
from procedures.report.origin import inputs_section
from procedures.report.source import Source
from procedures.report.space import base_axes, lines, space
from procedures.report.timeline import timeline_section
from procedures.report.verdict import banner, cards

_REMEDY = {
    "max_error_t_m": "Calibrate the fixed camera again with cone-capture, then check it again.",
    "max_error_r_rad": "Calibrate the fixed camera again with cone-capture, then check it again.",
}
_LONGEST_M = 0.12  # an arrow of the map


def verdict_section(source: Source[AxbcResult]) -> Html:
    """The verdict, why, and four figures to take away."""
    top = banner(source, _REMEDY, "Correct what the reason names, and check again.")
    if source.found is None:
        return top
    answer = source.found.result
    chosen = answer.correction.chosen
    return Html(
        top
        + cards(
            (
                (mm(answer.eval.t), "the given hand-eye is off by, at the base"),
                (deg(answer.eval.r), "and is turned by"),
                (mm(answer.C_offset.t), "the target is off its given place by"),
                (
                    mm(answer.correction.by_way()[chosen]),
                    f"held-out error of the target, corrected by {WAYS[chosen]}",
                ),
            )
        )
    )


def judgement_section(source: Source[AxbcResult]) -> Html | None:
    """What was given, what the images say of it, and which of it is blamed."""
    if source.found is None:
        return None
    answer = source.found.result
    rows: list[tuple[str, object, str]] = [
        (
            "Hand-eye as given",
            f"{mm(answer.eval.t)}, {deg(answer.eval.r)}",
            f"Off the standard, which knows it to {mm(answer.eval_sigma.t)}, "
            f"{deg(answer.eval_sigma.r)} (standard deviation).",
        ),
        (
            "Target's place as given",
            f"{mm(answer.C_offset.t)}, {deg(answer.C_offset.r)}",
            "Off the place that images and arm alone find; its error is common to all poses.",
        ),
        (
            "Blamed",
            el("b", answer.blamed),
            f"{BLAMED[answer.blamed]}.",
        ),
    ]
    rows += [(f"Known of {part}", told, "") for part, told in source.found.uncertainty.priors.items()]
    return section("What was given, and what the images say of it", facts(rows))


def map_section(source: Source[AxbcResult]) -> Html | None:
    """The flange through the camera against the reported one, over the workspace, in space."""
    if source.found is None:
        return None
    p, d, scale = _arrows(source.found.result)
    fig = figure(480, scene=space(np.vstack([p, p + scale * d, np.zeros((1, 3))]), 0.1))
    fig.add_trace(_dots(p, d))
    fig.add_trace(
        lines([np.array([a, a + scale * b]) for a, b in zip(p, d, strict=True)], NOW, 4.0, "off by")
    )
    for trace in base_axes(0.15):
        fig.add_trace(trace)
    words = "Two plain views of it follow. Drag to turn."
    return section("Positioning over the workspace", embed(fig, "positioning"), note(words), name="space")


def map_views_section(source: Source[AxbcResult]) -> Html | None:
    """The same from above and from the side: also readable on paper."""
    if source.found is None:
        return None
    answer = source.found.result
    p, d, scale = _arrows(answer)
    fig = make_subplots(
        1, 2, subplot_titles=("from above (x, y)", "from the side (x, z)"), horizontal_spacing=0.1
    )
    dressed(fig, 340)
    ends = p + scale * d
    for column, b in ((1, 1), (2, 2)):
        between = [[start[k], end[k], None] for k in (0, b) for start, end in zip(p, ends, strict=True)]
        x, y = np.reshape(np.array(between, dtype=object), (2, -1)).tolist()
        fig.add_trace(polyline(x, y, NOW, width=2.0), 1, column)
        marker = {"size": 6, "color": BEFORE}
        fig.add_trace(
            go.Scatter(x=p[:, 0].tolist(), y=p[:, b].tolist(), mode="markers", marker=marker), 1, column
        )
        fig.update_xaxes(title_text="x, m", row=1, col=column)
        anchor = "x" if column == 1 else f"x{column}"
        fig.update_yaxes(title_text=f"{'xyz'[b]}, m", scaleanchor=anchor, row=1, col=column)
    fig.update_layout(showlegend=False)
    longest = float(np.linalg.norm(d, axis=1).max())
    return section(
        "How far the camera is off, over the workspace",
        embed(fig, "positioning-views"),
        note(
            "Where the given hand-eye sees the flange, less where the arm reports it: "
            f"{mm(answer.positioning.t_rms)} RMS, {mm(longest)} at most. A dot is the flange, in the base; "
            f"its line is {scale:.0f} times as long as what it shows."
        ),
    )


def _arrows(answer: AxbcAnswer) -> tuple[Array, Array, float]:
    """Places of the flange (m, n by 3), by how much each is off, and the scale at which that is drawn."""
    p, d = np.array([place.p for place in answer.places]), np.array([place.d for place in answer.places])
    longest = float(np.linalg.norm(d, axis=1).max())
    return p, d, _LONGEST_M / longest if longest > 0.0 else 0.0


def _dots(p: Any, d: Any) -> Any:
    size = 1e3 * np.linalg.norm(d, axis=1)
    return go.Scatter3d(
        x=p[:, 0].tolist(),
        y=p[:, 1].tolist(),
        z=p[:, 2].tolist(),
        mode="markers",
        name="flange",
        marker={"size": 4, "color": BEFORE},
        text=[f"{s:.3f} mm" for s in size],
        hovertemplate="%{text}<extra></extra>",
    )


def correction_section(source: Source[AxbcResult]) -> Html | None:
    """The three ways to correct targets, at poses that were not looked at."""
    if source.found is None:
        return None
    correction = source.found.result.correction
    rows = [
        (el("b", WAYS[way]), mm(rms), "chosen") if way == correction.chosen else (WAYS[way], mm(rms), "")
        for way, rms in correction.by_way().items()
        if rms is not None
    ]
    return section(
        "Correcting targets",
        table(("way", "held-out error, RMS", ""), rows, "lrl"),
        note(
            "Each fifth of the poses is predicted from the others. A way is only taken when it is surely "
            "better than a simpler one; the noise of a single image is in all of these figures."
        ),
        *(note(line.strip()) for line in shift_lines(source.found.result)),
    )


def driven_section(source: Source[AxbcResult]) -> Html | None:
    """What was off at each target that the arm was driven to."""
    if source.found is None or (driven := source.found.result.driven) is None:
        return None
    fig = figure(260)
    for name, tint, ways in (
        ("as given", BEFORE, [(t.number, t.before) for t in driven.targets]),
        ("corrected", NOW, [(t.number, t.after) for t in driven.targets]),
    ):
        seen = [(number, at) for number, at in ways if at is not None]
        fig.add_trace(
            go.Scatter(
                x=[number for number, _ in seen],
                y=[1e3 * at.off_m for _, at in seen],
                error_y={"type": "data", "array": [1e3 * at.off_95_m for _, at in seen]},
                mode="markers",
                name=name,
                marker={"size": 8, "color": tint},
            )
        )
    fig.update_xaxes(title_text="target", dtick=1)
    fig.update_yaxes(title_text="off, mm", rangemode="tozero")
    rows = [(str(t.number), seen_text(t.before), seen_text(t.after)) for t in driven.targets]
    said = [driven.meaning, *(f"Not measured: {what}." for what in driven.lost)]
    if driven.stands is not None:
        said.append(f"Not returned: {driven.stands}.")
    if driven.way == "none":
        said.insert(0, "No correction is surely better than none, so targets were driven to as given only.")
    if driven.better is not None:
        said.insert(0, f"{gain_text(driven)}.")
    return section(
        "Targets that were driven to",
        embed(fig, "targets"),
        table(("target", "off as given", "off corrected"), rows, "lll"),
        *(note(line) for line in said),
    )


def _page(_source: Source[AxbcResult]) -> Page[Source[AxbcResult]]:
    return Page(
        top=(verdict_section, judgement_section),
        left=(map_section, map_views_section),
        right=(correction_section, driven_section),
        rest=(timeline_section, inputs_section),
    )


EYE_TO_HAND = Layout(
    source=Source[AxbcResult],
    data_file=FILE_NAME,
    title=lambda _source: "Eye-to-hand check",
    page=_page,
    cover=axbc_cover,
)
