"""Places along the beams: a reference crosses each beam at two of them or more."""

from collections.abc import Mapping

import numpy as np

from calibration.tool_frame.crossings import Crossing
from calibration.tool_frame.geometry import BEAMS, BeamFrame
from calibration.tool_frame.scene import Refused, ToolFrameScene
from cell.poses import Array

MIN_APART_M = 0.04
_SAME_PLACE_M = 0.005


def at_current_places(scene: ToolFrameScene) -> ToolFrameScene:
    """``scene`` with those reference passes alone that crossed where the current ones cross.

    The beams' directions come from the reference itself, so that its passes at another place along a beam are
    on that line by construction: they would make the comparison look better known than it is.
    """
    tips = [0.5 * (p.pose_xyz[0] + p.pose_xyz[-1]) for p in scene.passes]
    along = [float(scene.beams[p.beam].direction @ tip) for p, tip in zip(scene.passes, tips, strict=True)]
    now = {
        b: [a for a, p in zip(along, scene.passes, strict=True) if p.current and p.beam == b] for b in BEAMS
    }
    keep = [
        k
        for k, p in enumerate(scene.passes)
        if p.current or not now[p.beam] or min(abs(along[k] - a) for a in now[p.beam]) < 0.5 * MIN_APART_M
    ]
    there = {scene.passes[k].beam for k in keep if not scene.passes[k].current}
    return scene.take(keep) if len(there) == len(BEAMS) else scene


class CrossingPlaces:
    """``along`` (k,) m is, by beam, where along it it was crossed, in the order of the first visits; ``of``
    the number of that place for each pass of ``scene``."""

    def __init__(self, scene: ToolFrameScene, frames: Mapping[str, BeamFrame]) -> None:
        self._scene, self._frames = scene, frames
        self.along: dict[str, Array] = {b: self._visited(b) for b in BEAMS}
        self.of = {
            k: int(np.argmin(np.abs(self.along[p.beam] - self._tip(k)))) for k, p in enumerate(scene.passes)
        }

    def check(self, crossings: Mapping[int, Crossing]) -> None:
        """Refuse crossings that do not tell the direction of each beam."""
        for b in BEAMS:
            visited = self.used(crossings, b)
            if not visited:
                raise Refused("too-few-passes", f"no pass across beam {b} can be used")
            if len(visited) < 2 or np.ptp([self.along[b][j] for j in visited]) < MIN_APART_M:
                raise Refused(
                    "one-place-only",
                    f"beam {b} was crossed at one place, or at places less than {1e3 * MIN_APART_M:.0f} mm "
                    "apart; its direction is not determined",
                )

    def used(self, crossings: Mapping[int, Crossing], beam: str) -> set[int]:
        """The places of one beam at which ``crossings`` are."""
        return {self.of[k] for k, c in crossings.items() if c.source.beam == beam}

    def span(self, crossings: Mapping[int, Crossing], beam: str) -> float:
        """Greatest span of heights (m) at one place of a beam."""
        spans = [0.0]
        for j in self.used(crossings, beam):
            own = (c for k, c in crossings.items() if c.source.beam == beam and self.of[k] == j)
            spans.append(float(np.ptp([float(np.mean(c.above)) for c in own])))
        return max(spans)

    def _visited(self, beam: str) -> Array:
        centres: list[float] = []
        own = [k for k, p in enumerate(self._scene.passes) if p.beam == beam]
        for k in sorted(own, key=lambda k: float(self._scene.passes[k].pose_t[0])):
            a = self._tip(k)
            if all(abs(a - c) > _SAME_PLACE_M for c in centres):
                centres.append(a)
        return np.array(centres)

    def _tip(self, k: int) -> float:
        """Where along its beam a pass has the tool's point, m."""
        p = self._scene.passes[k]
        tip = 0.5 * (p.pose_xyz[0] + p.pose_xyz[-1]) + self._scene.R @ self._scene.tool.p
        line = self._frames[p.beam].line
        return float((tip - line.point) @ line.direction)
