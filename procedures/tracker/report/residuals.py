"""Before and after, pose by pose: held-out distances beside the nominal arm's, and what was not used."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from procedures.report.figure import BEFORE, NOW, REJECTED, SOFT, dressed, embed, label
from procedures.report.html import Html, el, facts, note, section, table
from procedures.report.numbers import mm
from procedures.tracker.report.source import KincalSource
from procedures.tracker.result import SampleResidual

Rows = list[SampleResidual]
_AXES = "xyz"


def before_section(source: KincalSource) -> Html | None:
    """Distances of the nominal and of the calibrated arm, and how many poses stay below which distance."""
    if source.found is None:
        return None
    rows = [r for r in source.per_sample if r.used]
    return section(
        "Before and after",
        embed(_before_figure(source, rows), "before-after"),
        note(
            "Left: distance of each reading from where the arm was expected, nominal (in the place of the "
            "tracker that suits it best) and calibrated (by an arm that did not see this pose). Right: share "
            f"of the poses that stay below a distance. The dashed line is {_dashed(source)} "
            "Logarithmic scales."
        ),
    )


def _dashed(source: KincalSource) -> str:
    size = mm(source.tracker_3d)
    if source.whose_noise == "tracker":
        return f"√3 times the tracker's sigma, {size}: what is near it is the tracker as much as the arm."
    return (
        f"√3 times the sigma of the residuals, {size}. The tracker's noise was not given, so "
        "it does not tell what is the tracker and what the arm."
    )


def _before_figure(source: KincalSource, rows: Rows) -> Any:
    fig = make_subplots(1, 2, column_widths=[0.62, 0.38], horizontal_spacing=0.09)
    dressed(fig, 360)
    nominal = [(r, r.nominal) for r in rows]
    held_out = [(r, r.heldout) for r in rows if r.heldout is not None]
    for known, tint, name in ((nominal, BEFORE, "nominal"), (held_out, NOW, "calibrated, held out")):
        at, off = [r.index for r, _ in known], [1e3 * v for _, v in known]
        texts = [f"pose {r.index}, {label(r.target)}<br>{name} {mm(v)}" for r, v in known]
        marks = {"color": tint, "size": 7}
        shared = {"name": name, "legendgroup": name}
        fig.add_trace(
            go.Scatter(
                x=at, y=off, mode="markers", marker=marks, text=texts, hovertemplate="%{text}<extra></extra>",
                **shared,
            ),
            1, 1,
        )  # fmt: skip
        share = 100.0 * np.arange(1, len(off) + 1) / len(off)
        line = {"color": tint, "width": 2, "shape": "hv"}
        fig.add_trace(
            go.Scatter(x=sorted(off), y=share, mode="lines", line=line, showlegend=False, **shared), 1, 2
        )
    if source.tracker_3d:
        dashed = {"color": SOFT, "dash": "dash", "width": 1.4}
        fig.add_hline(y=1e3 * source.tracker_3d, line=dashed, row=1, col=1)
        fig.add_vline(x=1e3 * source.tracker_3d, line=dashed, row=1, col=2)
    fig.update_yaxes(type="log", title_text="distance, mm", row=1, col=1)
    fig.update_xaxes(title_text="number of the pose", row=1, col=1)
    fig.update_xaxes(type="log", title_text="distance, mm", row=1, col=2)
    fig.update_yaxes(title_text="poses below, %", range=[0, 102], row=1, col=2)
    return fig


def residuals_section(source: KincalSource) -> Html | None:
    """Residuals of the solution along the base's axes, and the samples that were left out."""
    if source.found is None:
        return None
    rows, found = source.per_sample, source.found.residuals
    return section(
        "Residuals of each pose",
        embed(_figure(source, rows), "residuals"),
        note("Along the axes of the base. A red cross was not used; at the border it lies beyond."),
        facts(
            [
                (
                    "Residuals, RMS",
                    mm(found.rms),
                    "Of the poses in use, against the arm that was solved from them: how well the model "
                    "fits, not how accurate the arm is.",
                ),
                (
                    "largest",
                    mm(found.max),
                    "A pose beyond what chance explains is left out, and listed.",
                ),
            ]
        ),
        _rejected(source),
    )


def _figure(source: KincalSource, rows: Rows) -> Any:
    fig = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.05)
    dressed(fig, 470)
    rejected = source.rejected
    inside = [r for r in rows if r.used]
    targets = list(dict.fromkeys(r.target for r in rows))
    symbols = ("circle", "square", "diamond", "triangle-up")
    for axis, letter in enumerate(_AXES, start=1):
        for k, name in enumerate(targets):
            used = [r for r in inside if r.target == name]
            mark = {"color": NOW, "size": 7, "symbol": symbols[k % len(symbols)]}
            legend = axis == 1 and len(targets) > 1
            fig.add_trace(_dots(used, axis - 1, mark, name, rejected, legend), axis, 1)
        limit = 1.3 * (max((abs(_component(r, axis - 1)) for r in inside), default=1.0) or 1.0)
        left_out = [r for r in rows if not r.used]
        if left_out:
            cross = {"color": REJECTED, "size": 8, "symbol": "x"}
            trace = _dots(left_out, axis - 1, cross, "not used", rejected, axis == 1)
            trace.y = [min(max(v, -limit), limit) for v in trace.y]
            fig.add_trace(trace, axis, 1)
        fig.update_yaxes(title_text=f"{letter}, mm", range=[-1.08 * limit, 1.08 * limit], row=axis, col=1)
    fig.update_xaxes(title_text="number of the pose", row=3, col=1)
    return fig


def _component(row: SampleResidual, axis: int) -> float:
    """Millimetres along one axis of the base."""
    return 1e3 * row.e_base[axis]


def _dots(rows: Rows, axis: int, mark: Any, name: str, rejected: dict[int, str], legend: bool) -> Any:
    return go.Scatter(
        x=[r.index for r in rows],
        y=[_component(r, axis) for r in rows],
        mode="markers",
        marker=mark,
        name=label(name),
        legendgroup=name,
        showlegend=legend,
        text=[_hover(r, rejected) for r in rows],
        hovertemplate="%{text}<extra></extra>",
    )


def _hover(row: SampleResidual, rejected: dict[int, str]) -> str:
    range_m = "?" if row.range_m is None else f"{row.range_m:.2f}"
    lines = [f"pose {row.index}, {label(row.target)}", f"off by {mm(row.distance)} at {range_m} m"]
    if row.of_chance is not None:
        lines.append(f"{row.of_chance:.1f} times what chance explains")
    why = rejected.get(row.index)
    return "<br>".join([*lines, label(why)] if why else lines)


def _rejected(source: KincalSource) -> Html:
    rejected = source.rejected
    if not rejected:
        return note("Every sample was used.")
    return Html(
        el("h3", "Samples that were not used") + table(("number", "why"), sorted(rejected.items()), "r")
    )
