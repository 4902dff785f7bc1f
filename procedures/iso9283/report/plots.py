"""Deviations and arrivals of the test, drawn."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from procedures.iso9283.report.source import IsoSource
from procedures.report.figure import PALETTE, SOFT, dressed, embed, figure, label, legend_below, polyline
from procedures.report.html import Html, absent, note, paragraph, section
from procedures.report.numbers import mm

_AXES = "xyz"


def deviation_section(source: IsoSource) -> Html | None:
    """Barycentre minus commanded place, along the axes of the base."""
    if not source.poses:
        return None
    fig = figure(320, barmode="group")
    names = [label(p.name) for p in source.poses]
    for axis, letter in enumerate(_AXES):
        values = [1e3 * p.deviation[axis] for p in source.poses]
        fig.add_trace(
            go.Bar(
                x=names,
                y=values,
                name=letter,
                marker={"color": PALETTE[axis]},
                hovertemplate=f"%{{x}} {letter}: %{{y:.4f}} mm<extra></extra>",
            )
        )
    fig.update_yaxes(title_text="barycentre − commanded, mm")
    return section(
        "Where the arm goes instead",
        embed(fig, "deviation"),
        note("Mean of all arrivals less what was commanded, along x, y and z of the base; AP is its length."),
    )


def arrivals_section(source: IsoSource) -> Html | None:
    """Every arrival about the barycentre of its pose, from above and from the side."""
    if not source.poses:
        return None
    title = "Every arrival"
    drawn = [(p, source.arrivals(p.name)) for p in source.poses]
    if not any(len(off) for _, (_, off) in drawn):
        return section(title, absent("The result does not list its arrivals."))
    fig = make_subplots(2, len(drawn), subplot_titles=[label(p.name) for p, _ in drawn],
                        horizontal_spacing=0.035, vertical_spacing=0.09)  # fmt: skip
    dressed(fig, 470, margin={"l": 60, "r": 10, "t": 30, "b": 44})
    limit = 1.1e3 * max(float(np.abs(off).max(initial=0.0)) for _, (_, off) in drawn)
    limit = max(limit, 1.1e3 * max(p.RP for p, _ in drawn))
    for column, (pose, (cycles, off)) in enumerate(drawn, start=1):
        for row, (a, b) in enumerate(((0, 1), (0, 2)), start=1):
            fig.add_trace(_dots(cycles, off, a, b), row, column)
            for radius_m, dash in ((pose.RP_measured, "solid"), (pose.RP_tracker, "dot")):
                fig.add_trace(_circle(radius_m, dash), row, column)
            anchor = (row - 1) * len(drawn) + column
            axis = f"x{anchor}" if anchor > 1 else "x"
            fig.update_xaxes(
                range=[-limit, limit], title_text="x, mm" if row == 2 else None, row=row, col=column
            )
            title_text = f"{_AXES[b]}, mm" if column == 1 else None
            fig.update_yaxes(range=[-limit, limit], title_text=title_text, row=row, col=column)
            fig.update_yaxes(scaleanchor=axis, constrain="domain", row=row, col=column)
    fig.update_layout(showlegend=False)
    return section(
        title,
        embed(fig, "arrivals"),
        note(
            "About the barycentre of each pose, from above (x, y) and from the side (x, z) of the base; "
            "darker dots are later cycles. The circle is RP as measured, the dotted one the tracker's own."
        ),
    )


def _dots(cycles: list[int], off: Any, a: int, b: int) -> Any:
    return go.Scatter(
        x=1e3 * off[:, a],
        y=1e3 * off[:, b],
        mode="markers",
        marker={"size": 6, "color": cycles, "colorscale": "Blues", "cmin": -max(cycles, default=1)},
        text=[f"cycle {c}" for c in cycles],
        hovertemplate="%{text}: %{x:.4f}, %{y:.4f} mm<extra></extra>",
    )


def _circle(radius_m: float, dash: str) -> Any:
    angle = np.linspace(0.0, 2.0 * np.pi, 61)
    return polyline(
        1e3 * radius_m * np.cos(angle), 1e3 * radius_m * np.sin(angle), SOFT, width=1.1, dash=dash
    )


def drift_section(source: IsoSource) -> Html | None:
    """All poses over the cycles, along each axis, and whether they moved together."""
    if source.found is None:
        return None
    title, moved = "During the test", source.found.result.drift
    if moved is None:
        return section(title, absent("Fewer than six cycles: nothing can be said of drift."))
    fig = make_subplots(1, 3, subplot_titles=_AXES, horizontal_spacing=0.07)
    dressed(fig, 280)
    for k, pose in enumerate(source.poses):
        cycles, off = source.arrivals(pose.name)
        for axis in range(3):
            fig.add_trace(
                go.Scatter(
                    x=cycles,
                    y=1e3 * off[:, axis],
                    mode="lines+markers",
                    marker={"size": 4},
                    line={"color": PALETTE[k], "width": 1},
                    name=label(pose.name),
                    legendgroup=str(k),
                    showlegend=axis == 0,
                    hovertemplate="cycle %{x}: %{y:.4f} mm<extra></extra>",
                ),
                1,
                axis + 1,
            )
            fig.update_xaxes(title_text="cycle", row=1, col=axis + 1)
    fig.update_yaxes(title_text="mm", row=1, col=1)
    fig.update_layout(legend={**legend_below(280), "x": 1.0, "xanchor": "right"})
    words = "more than noise explains" if moved.beyond_noise else "within noise"
    return section(
        title,
        embed(fig, "drift"),
        paragraph(
            "From the first third of the cycles to the last, all poses moved together by "
            f"{mm(moved.distance_m)}, {words}."
        ),
    )
