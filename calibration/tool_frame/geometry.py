"""Beam and tool axis as lines in space: signed distances, and the tool's axis from two of its turns.

With the axis ``A = R a`` and the beam's direction ``d``, ``n = (A x d)/|A x d|`` is normal to both lines, so
that ``D = n.(p + R t - q)`` is their signed distance, whichever points ``t`` and ``q`` of them are taken. A
tilt of the tool turns ``n`` about ``d`` alone: the part of it that a beam can see is one angle ``beta``.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.tool_frame.scene import Line, ReferenceTool, Refused
from cell.poses import Array

BEAMS = ("xs", "ys")
MIN_CROSSING_RAD = 0.1  # between the two beams seen along the tool, and between beam and tool


@dataclass(frozen=True, eq=False)
class BeamFrame:
    """One beam as the reference tool sees it; unit vectors (3,) in the base.

    ``n`` is normal to beam and tool, ``w`` normal to beam and ``n`` with ``w . up > 0`` where ``up`` points
    from the tool's point to the flange. ``(n, w, turn d)`` is right-handed with ``turn`` = 1 or -1.
    """

    line: Line
    n: Array
    w: Array

    @classmethod
    def of(cls, line: Line, axis: Array) -> "BeamFrame":
        """``axis`` (3,) is the reference axis in the base; refused when the beam runs along the tool."""
        n = np.cross(axis, line.direction)
        length = float(np.linalg.norm(n))
        if length < np.sin(MIN_CROSSING_RAD):
            raise Refused(
                "beam-along-tool", "a beam runs along the tool's axis; crossing it there says nothing"
            )
        n = n / length
        w = np.cross(line.direction, n)
        return cls(line, n, w if w @ axis < 0.0 else -w)

    def across(self, points: Array) -> Array:
        """Signed distance (k,) of points (k, 3) along ``n``."""
        found: Array = (points - self.line.point) @ self.n
        return found

    def above(self, points: Array) -> Array:
        """The same along ``w``."""
        found: Array = (points - self.line.point) @ self.w
        return found

    def normal(self, beta: float) -> Array:
        """(3,) normal to the beam and to the tool turned by ``beta``."""
        found: Array = np.cos(beta) * self.n + np.sin(beta) * self.w
        return found


def frames(beams: Mapping[str, Line], R: Array, tool: ReferenceTool) -> dict[str, BeamFrame]:
    """Both beams; refused when they are parallel, seen along the tool."""
    axis = R @ tool.axis
    found = {name: BeamFrame.of(beams[name], axis) for name in BEAMS}
    sine = float(np.linalg.norm(np.cross(found["xs"].n, found["ys"].n)))
    if sine < np.sin(MIN_CROSSING_RAD):
        raise Refused(
            "beams-parallel",
            f"the beams cross at {np.degrees(np.arcsin(sine)):.1f} deg; the place along them is not seen",
        )
    return found


def turned_axis(beams: Mapping[str, BeamFrame], axis: Array, beta: Mapping[str, float]) -> Array:
    """(3,) the tool's axis in the base when each beam sees it turned by ``beta``; normal to both normals."""
    a = np.cross(beams["xs"].normal(beta["xs"]), beams["ys"].normal(beta["ys"]))
    a = a / np.linalg.norm(a)
    return a if a @ axis > 0.0 else -a


def seen_turn(frame: BeamFrame, axis: Array) -> float:
    """``beta`` that the beam sees of a tool along ``axis`` (3,) in the base."""
    n = np.cross(axis, frame.line.direction)
    n = n / np.linalg.norm(n)
    n = n if n @ frame.n > 0.0 else -n
    return float(np.arctan2(n @ frame.w, n @ frame.n))


def smallest_turn(before: Array, now: Array) -> Array:
    """(3,) rotation vector normal to both that takes the unit vector ``before`` to ``now``."""
    v = np.cross(before, now)
    sine, cosine = float(np.linalg.norm(v)), float(before @ now)
    return v * (np.arctan2(sine, cosine) / sine) if sine > 1e-12 else v


def rotated(axis: Array, turn: Array) -> Array:
    """(3,) ``axis`` turned by the rotation vector ``turn``."""
    found: Array = Rotation.from_rotvec(turn).apply(axis)
    return found


def in_base(beams: Mapping[str, BeamFrame], axis: Array, shift: Mapping[str, float], along: float) -> Array:
    """(3,) displacement in the base: ``shift`` along each beam's ``n``, ``along`` towards the flange."""
    rows = np.stack([beams["xs"].n, beams["ys"].n, -axis])
    found: Array = np.linalg.solve(rows, np.array([shift["xs"], shift["ys"], along]))
    return found
