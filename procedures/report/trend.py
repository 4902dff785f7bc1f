"""Health numbers over the runs: of the beams and the tool, of an arm and its tracker."""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from procedures.report.figure import PALETTE, dressed, embed, label, legend_below
from procedures.report.html import Html, absent, note, section
from procedures.report.numbers import number
from procedures.report.source import Source

_UNITS = {
    "_per_count": (1e6, "µm"),
    "_px": (1.0, "px"),
    "_s": (1e3, "ms"),
    "_m": (1e3, "mm"),
    "_rad": (180.0 / math.pi, "°"),
}
_PANELS = (
    ("hand_eye.moved_m", "camera, since the version before"),
    ("hand_eye.spread_within_m", "spread within placements"),
    ("hand_eye.spread_across_m", "spread across placements"),
    ("hand_eye.noise_px", "noise of a corner"),
    ("hand_eye.arm_m", "error of the arm's model"),
    ("beams.latency_s", "delay of the beams"),
    ("flange_camera.latency_s", "delay of the camera on the flange"),
    ("fixed_camera.latency_s", "delay of the fixed camera"),
    ("belt.latency_s", "delay of the encoder"),
    ("beams.hysteresis_m", "hysteresis of the beams"),
    ("tool.offset_", "displacement of the point"),
    ("tool.tilt_", "tilt of the axis"),
    ("kinematics.rms_before_m", "error, nominal arm"),
    ("kinematics.rms_after_m", "error, calibrated arm"),
    ("tracker.drift_m", "drift of the monuments"),
    ("iso9283.AP_m", "AP, worst pose"),
    ("iso9283.RP_m", "RP, worst pose"),
    ("belt.m_per_count", "one count of the belt"),
)


def trend_section(source: Source[Any]) -> Html | None:
    """One panel a number, with the values of earlier runs; the last dot is this run."""
    title = "Over the runs"
    found = source.result.made_from().trend or {}
    histories = {name: _history(points) for name, points in found.items()}
    panels = [(words, _chosen(histories, prefix)) for prefix, words in _PANELS]
    drawn = [(words, mine) for words, mine in panels if mine]
    if not drawn:
        if not source.run:
            return None  # a data set has no history
        return section(title, absent("No health numbers of earlier runs came with this result."))
    fig = make_subplots(1, len(drawn), subplot_titles=[words for words, _ in drawn], horizontal_spacing=0.09)
    dressed(fig, 280)
    for column, (_, mine) in enumerate(drawn, start=1):
        unit = ""
        for k, (name, points) in enumerate(mine.items()):
            scale, unit = _unit(name)
            fig.add_trace(_line(name, points, scale, PALETTE[k], len(mine) > 1), 1, column)
        fig.update_yaxes(title_text=unit, row=1, col=column)
        fig.update_xaxes(
            nticks=4, range=_days([t for points in mine.values() for t, _ in points]), row=1, col=column
        )
    fig.update_layout(legend={**legend_below(280), "x": 1.0, "xanchor": "right"})
    return section(
        title,
        embed(fig, "trend"),
        note("Each dot is one run (UTC), the last is this one. What creeps here shows before parts are bad."),
    )


def _history(value: Any) -> list[tuple[float, float]]:
    rows = value if isinstance(value, list) else []
    pairs = [(number(r[0]), number(r[1])) for r in rows if isinstance(r, list | tuple) and len(r) == 2]
    return [(t, v) for t, v in pairs if t is not None and v is not None]


def _chosen(histories: Mapping[str, list[tuple[float, float]]], prefix: str) -> dict[str, Any]:
    return {name: points for name, points in histories.items() if name.startswith(prefix) and points}


def _days(times: list[float]) -> list[str]:
    """The span that is shown: of a few runs of one day, that day."""
    spare = max(0.04 * (max(times) - min(times)), 6 * 3600.0 - 0.5 * (max(times) - min(times)))
    return [_wall(min(times) - spare), _wall(max(times) + spare)]


def _wall(t: float) -> str:
    return datetime.fromtimestamp(t, UTC).isoformat(timespec="seconds")


def _unit(name: str) -> tuple[float, str]:
    """Scale and unit for people of ``tool.offset_x_m.gripper``."""
    quantity = name.split(".")[1]
    return next((found for suffix, found in _UNITS.items() if quantity.endswith(suffix)), (1.0, ""))


def _line(name: str, points: list[tuple[float, float]], scale: float, tint: str, legend: bool) -> Any:
    short = name.split(".")[1].removeprefix("offset_")[:1]
    return go.Scatter(
        x=[_wall(t) for t, _ in points],
        y=[v * scale for _, v in points],
        mode="lines+markers",
        line={"color": tint, "width": 1.2},
        marker={"color": tint, "size": [5] * (len(points) - 1) + [10]},
        name=label(short),
        showlegend=legend,
        hovertemplate=f"{label(name)}<br>%{{x}}<br>%{{y:.4f}}<extra></extra>",
    )
