"""Where the tool's point is along its axis: which passes hit, which missed, and what the end's shape does."""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.crossings import Seen
from calibration.tool_frame.geometry import BEAMS, BeamFrame
from calibration.tool_frame.height import Bracket, Rise, along_axis, bracket
from calibration.tool_frame.scene import Scene
from calibration.tool_frame.selection import Selection
from calibration.tool_frame.system import At
from calibration.tool_frame.tip import Touch, View, bulge_change, weigh
from cell.poses import Array

_MAX_BEAM_OFF_M = 5e-4
_LATE_CLEARING_M = 5e-4
_WIDTH_M = 3e-5
_STATED_M = 2e-5

Bulges = Mapping[str, tuple[float, float]]


class Vertical:
    """The heights of one comparison.

    ``lifts`` (3,) are, by beam, the directions in which a pass is higher without being elsewhere across;
    ``brackets`` those of each beam and set (current or not) along its lift, ``height`` (m) what is to be
    added to heights above a beam whose stated point cannot be right.
    """

    def __init__(
        self, scene: Scene, frames: Mapping[str, BeamFrame], seen: Seen, selection: Selection
    ) -> None:
        self.scene, self.frames, self.seen, self.selection = scene, frames, seen, selection
        self.axis: Array = scene.R @ scene.tool.axis
        self.warnings: list[tuple[str, str]] = []
        self.lifts = {b: self._lift(b) for b in BEAMS}
        self.brackets = self._brackets()
        self.height = self._height_of_beams()

    @property
    def blunders(self) -> dict[int, str]:
        """Passes that contradict most of the others, by their places, with the reason."""
        reason = "contradicts the height at which the other passes meet the beam"
        return {k: reason for b in self.brackets.values() for k in b.blunders}

    def along(self, at: At, bulges: Bulges) -> tuple[float, float | None]:
        """Displacement along the axis towards the flange (m), and its standard deviation; None: unknown."""
        rises = []
        sideways = self.displacement(at, 0.0)
        for beam in BEAMS:
            a, b = self.brackets.get((beam, False)), self.brackets.get((beam, True))
            if a is not None and b is not None:
                bulge, sigma = bulges.get(beam, (0.0, 0.0))
                offset = float(self.lifts[beam] @ sideways) - bulge
                rises.append(Rise(a, b, float(-self.axis @ self.lifts[beam]), offset, sigma))
        if not rises:
            return 0.0, None
        return along_axis(rises)

    def displacement(self, at: At, z: float) -> Array:
        """(3,) m of the tool's point in the base, with ``z`` along the axis."""
        return geo.in_base(self.frames, self.axis, {b: at.shift.get(b, 0.0) for b in BEAMS}, z)

    def bulges(self, edges: Mapping[str, Array], at: At, tilt_sigma: float) -> Bulges:
        """For each beam, how much lower the tilted end reaches than in the reference, and its sigma (m).

        ``edges`` (k,) m are the places of the tool's edges, ``tilt_sigma`` (rad) how well the tilt is known.
        """
        turned = {
            False: {b: at.own_tilt.get(b, 0.0) for b in BEAMS},
            True: {b: at.tilt.get(b, 0.0) for b in BEAMS},
        }
        radius = {b: 0.5 * float(edges[b][-1] - edges[b][0]) for b in BEAMS}
        if any(len(edges[b]) > 2 for b in BEAMS):
            # Of several fingers it is not known where along the beam each of them is.
            most = sum(radius[b] * abs(turned[True][b] - turned[False][b]) for b in BEAMS)
            return {b: (0.5 * most, most / np.sqrt(12.0)) for b in BEAMS}
        # A beam that clears later than it breaks makes all widths larger alike.
        wider = {b: radius[b] - self.scene.tool.radius for b in BEAMS}
        wider = {b: w if abs(w) <= _LATE_CLEARING_M else 0.0 for b, w in wider.items()}
        views = {
            (b, current): self._view(b, turned[current], radius[b] - wider[b])
            for b in BEAMS
            for current in (False, True)
        }
        weights = weigh(self._touches(views, wider))
        found = {}
        for b in BEAMS:
            change, sigma = bulge_change(views[b, False], views[b, True], weights)
            found[b] = change, float(np.hypot(sigma, tilt_sigma * radius[b] * (change != 0.0)))
        return found

    def _view(self, beam: str, turned: Mapping[str, float], radius: float) -> View:
        side = np.cross(self.frames[beam].line.direction, self.lifts[beam])
        side = side / np.linalg.norm(side)
        axis = geo.turned_axis(self.frames, self.axis, turned)
        return View(axis, self.frames[beam].normal(turned[beam]), self.lifts[beam], side, radius)

    def _touches(self, views: Mapping[tuple[str, bool], View], wider: Mapping[str, float]) -> list[Touch]:
        """The passes near the tool's end, as what they say of its shape."""
        found = []
        for k in self.selection.hits:
            c = self.seen.crossings.get(k)
            met = None if c is None else self.brackets.get((c.source.beam, c.source.current))
            if c is None or met is None:
                continue
            beam = c.source.beam
            view = views[beam, c.source.current]
            depth = met.middle - float(np.mean(c.source.pose_xyz @ self.lifts[beam]))
            if depth < view.radius:
                sigma = float(np.hypot(c.high[0] - c.low[0], c.high[-1] - c.low[-1])) / np.sqrt(12.0)
                width = c.chord - 2.0 * wider[beam]
                found.append(Touch(view, depth, met.sigma, width, float(np.hypot(sigma, _WIDTH_M))))
        return found

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

    def _brackets(self) -> dict[tuple[str, bool], Bracket]:
        found = {}
        for beam in BEAMS:
            for current in (False, True):
                height = {
                    k: float(np.mean(self.scene.passes[k].pose_xyz @ self.lifts[beam]))
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
                found[beam, False] = Bracket(met, met, assumed=True, conflict=_STATED_M)
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
                        "are believed",
                    )
                )
        return off
