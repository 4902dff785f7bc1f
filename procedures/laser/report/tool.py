"""The tool before and now as a picture: to scale, with what changed made large, among the beams and hits."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from calibration.tool_frame.scene import ReferenceTool
from cell.poses import Array
from procedures.laser.report.source import LaserSource
from procedures.report.figure import (
    BEFORE,
    INK,
    NOW,
    REJECTED,
    SOFT,
    dots,
    dressed,
    embed,
    legend_below,
    polyline,
)
from procedures.report.html import Html, absent, note, section
from procedures.report.numbers import mm

FLANGE_RADIUS_M = 0.0315  # outside of ISO 9409-1-50-4-M6; for the drawing only
_PIN_SHARE, _SHOWN_SHARE = 0.35, 0.2  # of the tool's length: its straight end, and the deviation as drawn
_FACTORS = [m * 10**k for k in range(5) for m in (1, 2, 5)]
_VIEWS = (("x", 0), ("y", 1))


def tool_section(source: LaserSource) -> Html:
    """Two plain views with the deviation made large, and the tool's point from above at its true size."""
    title = "The tool" if source.is_reference else "The tool before and now"
    factor = exaggeration(source)
    drawn = tool_figure(source, factor)
    if drawn is None:
        return section(title, absent("The data set is not at hand, so the tool cannot be drawn."))
    return section(title, embed(drawn, "tool"), note(_words(source, factor)))


def tool_figure(source: LaserSource, factor: int) -> Any:
    """The picture with ``factor`` times the deviation; None where the data set does not say enough."""
    before, R = source.before, source.R
    if before is None or R is None:
        return None
    titles = ["from the front (x, z)", "from the side (y, z)"]
    titles += [] if source.dp is None else ["its point from above, true size"]
    fig = make_subplots(1, len(titles), subplot_titles=titles, horizontal_spacing=0.07)
    dressed(fig, 540)
    scene = _Scene(source, R, before)
    for column, (letter, axis) in enumerate(_VIEWS, start=1):
        first = column == 1
        for trace in scene.view(axis, factor, first):
            fig.add_trace(trace, 1, column)
        fig.update_xaxes(title_text=f"{letter}, mm (base)", constrain="domain", row=1, col=column)
        fig.update_yaxes(title_text="z, mm (base)" if first else None, row=1, col=column)
        fig.update_yaxes(scaleanchor=f"x{'' if first else column}", constrain="domain", row=1, col=column)
    if source.dp is not None:
        for trace in _point(source, source.dp, R):
            fig.add_trace(trace, 1, 3)
        fig.update_xaxes(title_text="x, mm (base)", constrain="domain", row=1, col=3)
        fig.update_yaxes(title_text="y, mm (base)", scaleanchor="x3", constrain="domain", row=1, col=3)
    fig.update_layout(legend=legend_below(540))
    return fig


def _words(source: LaserSource, factor: int) -> str:
    words = "Base frame. Flange, tool, beams and hits are to scale."
    if source.dp is None:
        return words
    words += (
        f" What changed is drawn {factor} times as large as it is. On the right is the tool's point at its "
        f"true displacement ({mm(float(np.linalg.norm(source.dp)))} in all, height included), with its 95 % "
        "region."
    )
    if source.drot is None:
        words += " The tilt was not measured, so the axis is drawn as it was."
    return words


def exaggeration(source: LaserSource) -> int:
    """The factor that makes the deviation visible beside the tool's length: 1, 2 or 5 with zeros."""
    before, dp = source.before, source.dp
    if before is None or dp is None:
        return 1
    length = float(np.linalg.norm(before.p))
    turned = 0.0 if source.drot is None else float(np.linalg.norm(source.drot)) * _PIN_SHARE * length
    moved = max(float(np.linalg.norm(dp)), turned)
    wanted = _SHOWN_SHARE * length / moved if moved > 0.0 else 1.0
    return max((f for f in _FACTORS if f <= wanted), default=1)


class _Scene:
    """Everything that is drawn, in the base, with the tool's point where the beams cross."""

    def __init__(self, source: LaserSource, R: Rotation, before: ReferenceTool) -> None:
        self.source, self.R, self.before = source, R, before
        self.centre = crossing(source)
        self.flange = self.centre - R.apply(before.p)
        self.length = max(float(np.linalg.norm(before.p)), 0.01)

    def view(self, axis: int, factor: int, legend: bool) -> list[Any]:
        """Traces of the projection on base axes ``axis`` and z, mm."""
        pick = [axis, 2]
        traces = [self._flange(pick)]
        large = self._large(factor)
        for tool, tint, name in ((self.before, BEFORE, "reference"), (large, NOW, f"now, × {factor}")):
            if tool is not None:
                traces += self._tool(tool, pick, tint, name, legend)
        return [*traces, *self._beams(pick, legend), *self._hits(pick, legend)]

    def _large(self, factor: int) -> ReferenceTool | None:
        dp, drot = self.source.dp, self.source.drot
        if dp is None:
            return None
        turn = Rotation.from_rotvec(factor * drot) if drot is not None else Rotation.identity()
        return ReferenceTool(self.before.p + factor * dp, turn.apply(self.before.axis), self.before.radius)

    def _flat(self, in_flange: Array, pick: list[int]) -> Array:
        """(n, 2) mm of points (n, 3) m in the flange."""
        return np.asarray(1e3 * (self.flange + self.R.apply(in_flange))[:, pick])

    def _flange(self, pick: list[int]) -> Any:
        """The flange as a flat cylinder, seen from the side it is seen from here."""
        angle = np.linspace(0.0, 2.0 * np.pi, 49)
        ring = FLANGE_RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        outline = _hull(self._flat(np.vstack([ring, ring - [0.0, 0.0, 0.012]]), pick))
        return _area(outline, SOFT, 0.55, "flange", False)

    def _tool(self, tool: ReferenceTool, pick: list[int], tint: str, name: str, legend: bool) -> list[Any]:
        """A cone from the flange to the straight end, the straight end at its radius, and the axis."""
        straight = tool.p - _PIN_SHARE * self.length * tool.axis
        axis = self._flat(np.array([np.zeros(3), straight, tool.p]), pick)
        radius = 1e3 * tool.radius
        cone = _hull(np.vstack([_edge(axis[0], axis[1], 18.0)[:2], _edge(axis[0], axis[1], radius)[2:]]))
        pin = _edge(axis[1], axis[2], radius)
        return [
            _area(cone, tint, 0.10, name, False),
            _area(np.vstack([pin, pin[:1]]), tint, 0.45, name, False),
            go.Scatter(
                x=axis[:, 0],
                y=axis[:, 1],
                mode="lines+markers",
                line={"color": tint, "width": 2},
                marker={"color": tint, "size": [0, 0, 8]},
                name=name,
                showlegend=legend,
                hoverinfo="name",
            ),
        ]

    def _beams(self, pick: list[int], legend: bool) -> list[Any]:
        """Each beam as a line, or as a dot where it points at the reader."""
        traces = []
        reach = 0.3 * self.length
        for k, (name, beam) in enumerate(self.source.beams.items()):
            middle = beam.point + np.dot(self.centre - beam.point, beam.direction) * beam.direction
            ends = 1e3 * (middle + np.outer([-reach, 0.0, reach], beam.direction))[:, pick]
            traces.append(
                go.Scatter(
                    x=ends[:, 0],
                    y=ends[:, 1],
                    mode="lines+markers",
                    line={"color": REJECTED, "width": 1.5},
                    marker={"color": REJECTED, "size": 6, "opacity": [0, 1, 0]},
                    name="beams",
                    text=[f"beam {name}"] * 3,
                    hoverinfo="text",
                    showlegend=legend and k == 0,
                )
            )
        return traces

    def _hits(self, pick: list[int], legend: bool) -> list[Any]:
        found = self.source.hits
        if not found:
            return []
        at = 1e3 * np.array(list(found.values()))[:, pick]
        return [
            go.Scatter(
                x=at[:, 0],
                y=at[:, 1],
                mode="markers",
                marker={"symbol": "diamond-open", "size": 11, "color": INK, "line": {"width": 2}},
                name="reference hits",
                text=[f"reference hit of beam {name}" for name in found],
                hoverinfo="text",
                showlegend=legend,
            )
        ]


def crossing(source: LaserSource) -> Array:
    """(3,) m: the middle of the shortest link of the two beams, else a point that can stand for it."""
    lines = list(source.beams.values())
    if len(lines) < 2:
        return lines[0].point if lines else np.zeros(3)
    (a, u), (b, v) = ((line.point, line.direction) for line in lines)
    across = np.column_stack([u, -v])
    (s, t), *_ = np.linalg.lstsq(across, b - a, rcond=None)
    return np.asarray(0.5 * (a + s * u + b + t * v))


def _point(source: LaserSource, dp: Array, R: Rotation) -> list[Any]:
    """The displacement of the point seen from above, mm, with the region that holds 95 %."""
    at = 1e3 * R.apply(dp)
    traces = [polyline([0.0, at[0]], [0.0, at[1]], SOFT, dash="dot", showlegend=False)]
    for place, tint in (([0.0, 0.0], BEFORE), (at[:2], NOW)):
        traces.append(dots([place[0]], [place[1]], tint, "%{x:.4f}, %{y:.4f} mm", size=9, showlegend=False))
    if source.cov is not None:
        turned = R.as_matrix() @ source.cov[:3, :3] @ R.as_matrix().T
        ring = at[:2] + 1e3 * _region95(turned[:2, :2])
        traces.append(_area(ring, NOW, 0.25, "95 %", False))
    return traces


def _region95(cov: Array) -> Array:
    """(n, 2): the outline that holds 95 % of normal vectors with covariance ``cov`` (2, 2)."""
    values, axes = np.linalg.eigh(cov)
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    half = np.sqrt(np.maximum(values, 0.0) * chdtri(2, 0.05))
    return np.asarray((circle * half) @ axes.T)


def _edge(a: Array, b: Array, half: float) -> Array:
    """(4, 2): the rectangle of half width ``half`` about the line from ``a`` to ``b`` (2,)."""
    along = b - a
    length = float(np.linalg.norm(along))
    side = half * (np.array([-along[1], along[0]]) / length if length > 0.0 else np.array([1.0, 0.0]))
    return np.array([a + side, a - side, b - side, b + side])


def _hull(points: Array) -> Array:
    """The convex outline (m, 2) of points (n, 2), closed."""
    loop = points[ConvexHull(points).vertices]
    return np.vstack([loop, loop[:1]])


def _area(outline: Array, tint: str, opacity: float, name: str, legend: bool) -> Any:
    return polyline(
        outline[:, 0],
        outline[:, 1],
        _faint(tint, min(1.0, 2.0 * opacity)),
        fill="toself",
        fillcolor=_faint(tint, opacity),
        name=name,
        showlegend=legend,
    )


def _faint(tint: str, opacity: float) -> str:
    red, green, blue = (int(tint[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:.2f})"
