"""Between which heights each beam was first met, from the passes that hit and that missed."""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.bounds import At
from calibration.tool_frame.crossings import PassContents
from calibration.tool_frame.geometry import BEAMS, BeamFrame
from calibration.tool_frame.hits import HeightBracket, bracket
from calibration.tool_frame.scene import ToolFrameScene
from calibration.tool_frame.selection import Selection
from cell.poses import Array

_MAX_BEAM_OFF_M = 5e-4


class Vertical:
    """The heights of one comparison.

    ``lifts`` (3,) are, by beam, the directions in which a pass is higher without being elsewhere across;
    ``brackets`` those of each beam and set (current or not) along its lift, ``height`` (m) what is to be
    added to heights above a beam whose stated point cannot be right.
    """

    def __init__(
        self, scene: ToolFrameScene, frames: Mapping[str, BeamFrame], seen: PassContents, selection: Selection
    ) -> None:
        self.scene, self.frames, self.seen, self.selection = scene, frames, seen, selection
        self.axis: Array = scene.R @ scene.tool.axis
        self.warnings: list[tuple[str, str]] = []
        self.lifts = {b: self._lift(b) for b in BEAMS}
        self.brackets = self._brackets()
        self.height = self._height_of_beams()

    @property
    def blunders(self) -> dict[int, str]:
        """Passes that contradict most of the others, by their places, with the reason.

        They do not count across the beams. The likelihood of the height has them, as it has every pass, with
        the chance that a pass is not what it seems."""
        reason = "contradicts the height at which the other passes meet the beam"
        return {k: reason for b in self.brackets.values() for k in b.blunders}

    def rough(self, at: At) -> float:
        """Displacement along the axis towards the flange (m), from the brackets' middles."""
        sideways = self.displacement(at, 0.0)
        found = []
        for beam in BEAMS:
            a, b = self.brackets.get((beam, False)), self.brackets.get((beam, True))
            if a is not None and b is not None:
                lower = a.middle - b.middle - float(self.lifts[beam] @ sideways)
                found.append(lower / float(-self.axis @ self.lifts[beam]))
        return float(np.mean(found)) if found else 0.0

    def displacement(self, at: At, z: float) -> Array:
        """(3,) m of the tool's point in the base, with ``z`` along the axis."""
        return geo.in_base(self.frames, self.axis, {b: at.shift.get(b, 0.0) for b in BEAMS}, z)

    def _own(self, places: Sequence[int], beam: str, current: bool) -> list[int]:
        passes = self.scene.passes
        return [k for k in places if passes[k].beam == beam and passes[k].current == current]

    def _lift(self, beam: str) -> Array:
        """(3,) normal to the beam and to the way across it, upwards."""
        frame = self.frames[beam]
        way = np.zeros(3)
        for c in self.seen.crossings.values():
            if c.source.beam == beam:
                step = c.source.pose_xyz[-1] - c.source.pose_xyz[0]
                way += step * np.sign(step @ frame.n)
        lift = np.cross(frame.line.direction, way)
        length = float(np.linalg.norm(lift))
        if length < 1e-9:
            return frame.w
        lift = lift / length
        return lift if lift @ self.axis < 0.0 else -lift

    def _brackets(self) -> dict[tuple[str, bool], HeightBracket]:
        found = {}
        for beam in BEAMS:
            for current in (False, True):
                height = {
                    k: float(self.scene.passes[k].middle @ self.lifts[beam])
                    for k in (*self.selection.hits, *self.selection.missed)
                }
                hits = {k: height[k] for k in self._own(self.selection.hits, beam, current)}
                misses = {k: height[k] for k in self._own(self.selection.missed, beam, current)}
                if (b := bracket(hits, misses)) is not None:
                    found[beam, current] = b
            if (beam, False) not in found and (beam, True) in found:
                # The reference is where its point meets the beam, if the beam is where it is said to be.
                line, tool = self.scene.beams[beam], self.scene.R @ self.scene.tool.p
                met = float(self.lifts[beam] @ (line.point - tool))
                found[beam, False] = HeightBracket(met, met, assumed=True)
                self.warnings.append(
                    (
                        "laser.reference-height",
                        f"no reference pass goes by above the tool's point at beam {beam}; its height is "
                        "taken from the point stated for the beam",
                    )
                )
        return found

    def _height_of_beams(self) -> dict[str, float]:
        """What is to be added to the heights above each beam, where the point given for it cannot be right.

        The reference's point is at the beam where it first meets it, but for the rounding of its end.
        """
        off: dict[str, float] = {}
        for beam in BEAMS:
            b = self.brackets.get((beam, False))
            if b is None or b.assumed:
                continue
            line = self.scene.beams[beam]
            met = b.middle + self.lifts[beam] @ (self.scene.R @ self.scene.tool.p - line.point)
            if abs(met) > self.scene.tool.radius + _MAX_BEAM_OFF_M:
                off[beam] = float(-met / (self.lifts[beam] @ self.frames[beam].w))
                self.warnings.append(
                    (
                        "laser.beam-height",
                        f"beam {beam} is {1e3 * met:.2f} mm from where the reference tool meets it; the hits "
                        "are used",
                    )
                )
        return off
