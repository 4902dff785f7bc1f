"""A beam as a line through the two places that are farthest apart, and what both beams fix together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame.geometry import BeamFrame
from calibration.tool_frame.scene import Line, ToolFrameScene
from cell.poses import Array


@dataclass(frozen=True, eq=False)
class FoundBeam:
    """One beam. ``line.point`` is where the tool's point meets it at the first place, m in the base;
    ``cov_point`` (3, 3) m^2, ``cov_direction`` (3, 3), ``var_across`` m^2 the variance of that point along
    the beam's ``n``. ``hit`` (3,) m is the flange there: half-chord centre and hit height. ``apart`` (m) is
    how far the places are apart along it, ``slope`` (rad) its rise against base x-y."""

    line: Line
    cov_point: Array
    cov_direction: Array
    var_across: float
    hit: Array
    apart: float

    @property
    def slope(self) -> float:
        return float(np.arcsin(np.clip(self.line.direction[2], -1.0, 1.0)))


def beam_through(
    scene: ToolFrameScene, frame: BeamFrame, ends: Sequence[tuple[float, float, float]], across: Array
) -> FoundBeam:
    """The beam through two places, the first of which it is stated at.

    ``ends`` has for each place: metres along the line that was given for the beam, height over that line (m)
    and its standard deviation. ``across`` (2, 3) has for each place the beam's
    offset along ``n`` (m) and then its row of the covariance (2, 2) of both.
    """
    line = frame.line
    points = [
        line.point + along * line.direction + float(offset) * frame.n + height * frame.w
        for (along, height, _), offset in zip(ends, across[:, 0], strict=True)
    ]
    lateral, heights = across[:, 1:], [sigma**2 for _, _, sigma in ends]
    step = points[1] - points[0]
    length = float(np.linalg.norm(step))
    sign = 1.0 if step @ line.direction > 0.0 else -1.0
    nn, ww = np.outer(frame.n, frame.n), np.outer(frame.w, frame.w)
    turn = lateral[0, 0] + lateral[1, 1] - 2.0 * lateral[0, 1]
    return FoundBeam(
        line=Line(points[0], sign * step / length),
        cov_point=lateral[0, 0] * nn + heights[0] * ww,
        cov_direction=(turn * nn + sum(heights) * ww) / length**2,
        var_across=float(lateral[0, 0]),
        hit=points[0] - scene.R @ scene.tool.p,
        apart=length,
    )


def point_cov(
    frames: Mapping[str, BeamFrame], axis: Array, beams: Mapping[str, FoundBeam], heights: Array
) -> Array:
    """(3, 3) m^2 of the point that both beams together fix, in the base, as ``axis`` (3,) of the tool;
    ``heights`` (2, 2) m^2 is the covariance of the two heights, what the tool's end adds to both included."""
    J = np.linalg.inv(np.stack([frames["xs"].n, frames["ys"].n, -axis]))
    # The two heights are averaged by their weights.
    z = 1.0 / float(np.sum(np.linalg.inv(heights)))
    found: Array = J @ np.diag([beams["xs"].var_across, beams["ys"].var_across, z]) @ J.T
    return found


def plane_gap(beams: Mapping[str, FoundBeam]) -> tuple[float, float]:
    """Height of beam ``xs`` over ``ys`` where they cross seen from above, with its 95 % uncertainty, m."""
    a, b = beams["xs"], beams["ys"]
    A = np.stack([a.line.direction[:2], -b.line.direction[:2]], axis=1)
    s, t = np.linalg.solve(A, b.line.point[:2] - a.line.point[:2])
    gap = float((a.line.point + s * a.line.direction - b.line.point - t * b.line.direction)[2])
    var = sum(
        f.cov_point[2, 2] * (1.0 - m / f.apart) ** 2
        + (f.cov_direction[2, 2] * f.apart**2 - f.cov_point[2, 2]) * (m / f.apart) ** 2
        for f, m in ((a, float(s)), (b, float(t)))
    )
    return gap, 1.96 * float(np.sqrt(max(var, 0.0)))
