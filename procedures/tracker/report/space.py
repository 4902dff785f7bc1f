"""The poses in space: the arm at each of them, its reflectors, and the tracker."""

from typing import Any

import numpy as np
import plotly.graph_objects as go

from cell.poses import Array
from procedures.report.figure import NOW, PALETTE, REJECTED, SOFT, embed, figure, label
from procedures.report.html import Html, absent, note, section
from procedures.report.space import base_axes, lines, space
from procedures.tracker.report.source import KincalSource, MeasuredSamples

_MOST_ARMS = 80


def space_section(source: KincalSource) -> Html:
    """Reflectors as the tracker saw them, in the base, with the calibrated arm under each."""
    title = "The poses in space"
    measured, T = source.measured, source.T_base_tracker
    if measured is None:
        return section(title, absent("The data set is not at hand, so the poses cannot be drawn."))
    if T is None:
        return section(title, absent("Without an answer the tracker's place in the base is unknown."))
    frames = source.frames
    arms = "" if frames is None else " The thin lines are the calibrated arm's links."
    return section(
        title,
        embed(_figure(measured, T, frames, source), "space"),
        note(
            "Dots are the reflector at each pose as the tracker saw it, brought to the base; a red cross was "
            f"not used.{arms} The dashed line goes to the tracker. Base frame, to scale; drag to turn."
        ),
        name="space",
    )


def _figure(measured: MeasuredSamples, T: Array, frames: Array | None, source: KincalSource) -> Any:
    fig = figure(520, margin={"l": 0, "r": 0, "t": 0, "b": 0})
    at = measured.p_tracker @ T[:3, :3].T + T[:3, 3]
    corners = np.vstack([at, np.zeros(3), T[:3, 3]])
    if frames is not None:
        shown = [np.vstack([frames[k], at[k]]) for k in range(min(len(at), _MOST_ARMS))]
        fig.add_trace(lines(shown, "#b9c2cd", 1.2, "the arm", False))
        corners = np.vstack([corners, *shown])
    rejected = source.rejected
    targets = list(dict.fromkeys(measured.target))
    for k, name in enumerate(targets):
        rows = [i for i, t in enumerate(measured.target) if t == name and measured.index[i] not in rejected]
        tint = NOW if len(targets) == 1 else PALETTE[k % len(PALETTE)]
        fig.add_trace(_dots(at[rows], tint, "circle", 4, name, [f"pose {measured.index[i]}" for i in rows]))
    if left_out := [i for i, number in enumerate(measured.index) if number in rejected]:
        texts = [f"pose {measured.index[i]}: {rejected[measured.index[i]]}" for i in left_out]
        fig.add_trace(_dots(at[left_out], REJECTED, "x", 5, "not used", texts))
    tracker = T[:3, 3]
    fig.add_trace(_dots(tracker[None], "#1b2430", "diamond", 8, "tracker", ["the tracker"]))
    sight = lines([np.array([tracker, at.mean(axis=0)])], SOFT, 2.0, "line of sight", False)
    sight.line.dash = "dash"
    fig.add_trace(sight)
    size = 0.08 * float(np.linalg.norm(np.ptp(at, axis=0)))
    fig.add_traces(base_axes(1.5 * size))
    fig.update_layout(scene=space(corners, 0.5 * size), showlegend=False)
    return fig


def _dots(at: Array, tint: str, symbol: str, size: int, name: str, texts: list[str]) -> Any:
    return go.Scatter3d(
        **{k: [round(float(v), 5) for v in at[:, i]] for i, k in enumerate("xyz")},
        mode="markers",
        marker={"color": tint, "symbol": symbol, "size": size},
        name=label(name),
        text=[label(text) for text in texts],
        hoverinfo="text",
    )
