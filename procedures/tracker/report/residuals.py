"""Before and after, pose by pose: held-out distances beside the nominal arm's, and what was not used."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from procedures.report.figure import BEFORE, NOW, REJECTED, SOFT, dressed, embed, label
from procedures.report.html import Html, absent, el, facts, note, section, table
from procedures.report.numbers import dig, mm, number
from procedures.tracker.report.source import KincalSource

Rows = list[Mapping[str, Any]]
_AXES = "xyz"


def before_section(source: KincalSource) -> Html | None:
    """Distances of the drawn and of the calibrated arm, and how many poses stay below which distance."""
    if source.answer is None:
        return None
    rows = [r for r in source.per_sample if r.get("used")]
    title = "Before and after"
    if not rows:
        return section(title, absent("The result has no residuals of single samples."))
    return section(
        title,
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
    for key, tint, name in (("nominal", BEFORE, "nominal"), ("heldout", NOW, "calibrated, held out")):
        known = [(r, v) for r in rows if (v := number(r.get(key))) is not None]
        if not known:
            continue
        at, off = [r.get("index") for r, _ in known], [1e3 * v for _, v in known]
        texts = [
            f"pose {label(r.get('index'))}, {label(r.get('target'))}<br>{name} {mm(v)}" for r, v in known
        ]
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
    if source.answer is None:
        return None
    rows = source.per_sample
    title = "Residuals of each pose"
    if not rows:
        return section(title, absent("The result has no residuals of single samples."), _rejected(source))
    found = source.result.get("residuals")
    return section(
        title,
        embed(_figure(source, rows), "residuals"),
        note("Along the axes of the base. A red cross was not used; at the border it lies beyond."),
        facts(
            [
                (
                    "Residuals, RMS",
                    mm(dig(found, "rms")),
                    "Of the poses in use, against the arm that was solved from them: how well the model "
                    "fits, not how accurate the arm is.",
                ),
                (
                    "largest",
                    mm(dig(found, "max")),
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
    inside = [r for r in rows if r.get("used")]
    targets = list(dict.fromkeys(str(r.get("target")) for r in rows))
    symbols = ("circle", "square", "diamond", "triangle-up")
    for axis, letter in enumerate(_AXES, start=1):
        for k, name in enumerate(targets):
            used = [r for r in inside if str(r.get("target")) == name]
            mark = {"color": NOW, "size": 7, "symbol": symbols[k % len(symbols)]}
            legend = axis == 1 and len(targets) > 1
            fig.add_trace(_dots(used, axis - 1, mark, name, rejected, legend), axis, 1)
        limit = 1.3 * max((abs(v) for r in inside if (v := _component(r, axis - 1))), default=1.0)
        left_out = [r for r in rows if not r.get("used")]
        if left_out:
            cross = {"color": REJECTED, "size": 8, "symbol": "x"}
            trace = _dots(left_out, axis - 1, cross, "not used", rejected, axis == 1)
            trace.y = [None if v is None else min(max(v, -limit), limit) for v in trace.y]
            fig.add_trace(trace, axis, 1)
        fig.update_yaxes(title_text=f"{letter}, mm", range=[-1.08 * limit, 1.08 * limit], row=axis, col=1)
    fig.update_xaxes(title_text="number of the pose", row=3, col=1)
    return fig


def _component(row: Mapping[str, Any], axis: int) -> float | None:
    """Millimetres along one axis of the base."""
    e = row.get("e_base")
    value = number(e[axis]) if isinstance(e, list) and len(e) == 3 else None
    return None if value is None else 1e3 * value


def _dots(rows: Rows, axis: int, mark: Any, name: str, rejected: dict[int, str], legend: bool) -> Any:
    return go.Scatter(
        x=[r.get("index") for r in rows],
        y=[_component(r, axis) for r in rows],
        mode="markers",
        marker=mark,
        name=label(name),
        legendgroup=name,
        showlegend=legend,
        text=[_hover(r, rejected) for r in rows],
        hovertemplate="%{text}<extra></extra>",
    )


def _hover(row: Mapping[str, Any], rejected: dict[int, str]) -> str:
    index = row.get("index")
    chance = number(row.get("of_chance"))
    lines = [
        f"pose {label(index)}, {label(row.get('target'))}",
        f"off by {mm(row.get('distance'))} at {label(_round(row.get('range_m')))} m",
    ]
    if chance is not None:
        lines.append(f"{chance:.1f} times what chance explains")
    why = rejected.get(index) if isinstance(index, int) else None
    return "<br>".join([*lines, label(why)] if why else lines)


def _round(value: Any) -> str:
    plain = number(value)
    return "?" if plain is None else f"{plain:.2f}"


def _rejected(source: KincalSource) -> Html:
    rejected = source.rejected
    if not rejected:
        return note("Every sample was used.")
    return Html(
        el("h3", "Samples that were not used") + table(("number", "why"), sorted(rejected.items()), "r")
    )
