"""The passes of a data set as the report draws them; edges and reasons are those of the estimator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calibration.tool_frame.crossings import Crossing, PassContents, see
from calibration.tool_frame.geometry import BEAMS, frames, rotated, seen_turn, turned_axis
from calibration.tool_frame.scene import ToolFrameScene
from calibration.tool_frame.selection import Selection, select
from cell.poses import Array
from procedures.laser.result import LaserResult, RejectedPass, RejectedReferencePass

Rejected = Sequence[RejectedPass | RejectedReferencePass]


@dataclass(frozen=True, eq=False)
class ShownPasses:
    """All passes, and what became of each; the places are those in ``scene.passes``."""

    scene: ToolFrameScene
    seen: PassContents
    chosen: Selection
    heights: Array  # (n,) m of the reference's point above each pass's beam, mean over the way
    unused: Mapping[int, str]  # crossings that say nothing across the beam, with the reason

    @property
    def used(self) -> set[int]:
        """The places of the crossings that tell where the tool is across the beams."""
        return set(self.seen.crossings) - set(self.unused)

    def of(self, beam: str, current: bool) -> list[int]:
        """The places of one beam's passes in the reference or now."""
        found = enumerate(self.scene.passes)
        return [k for k, p in found if p.beam == beam and p.current is current]


def shown(scene: ToolFrameScene, tau: float, rejected: Rejected = ()) -> ShownPasses:
    """``tau`` (s) is what is left of the delay in the stamps of the polls, ``rejected`` the result's list."""
    beams = frames(scene.beams, scene.R, scene.tool)
    seen = see(scene, beams, tau)
    tips = [p.pose_xyz.mean(axis=0) + scene.R @ scene.tool.p for p in scene.passes]
    heights = [float(beams[p.beam].above(tip[None])[0]) for p, tip in zip(scene.passes, tips, strict=True)]
    chosen = select(scene, seen)
    return ShownPasses(
        scene, seen, chosen, np.array(heights), {**chosen.reasons, **_rejected(scene, rejected)}
    )


def _rejected(scene: ToolFrameScene, listed: Rejected) -> dict[int, str]:
    """Place and reason of the passes that a result names by set and number."""
    why = {(isinstance(r, RejectedPass) and r.set_ == "current", r.index): r.reason for r in listed}
    places = ((k, why.get((p.current, p.index))) for k, p in enumerate(scene.passes))
    return {k: reason for k, reason in places if reason is not None}


def pairs(found: ShownPasses, beam: str, current: bool) -> list[tuple[int, int]]:
    """The places of each way out with the way back that followed it, where both are used."""
    own = sorted(found.of(beam, current), key=lambda k: float(found.scene.passes[k].pose_t[0]))
    rows = []
    for a, b in pairwise(own):
        out, back = found.scene.passes[a], found.scene.passes[b]
        if (out.direction, back.direction) == (1, -1) and {a, b} <= found.used:
            rows.append((a, b))
    return rows


@dataclass(frozen=True)
class EdgeEstimate:
    """What a solution says of each beam: where the tool's edges are, and how the passes see them.

    ``edges`` (k,) m are the places of the tool's edges along the beam's ``n``, the same for the reference and
    for the tool now; ``tilt`` (rad), ``shift`` and ``rise`` (m) are those of ``(beam, current)``.
    """

    edges: Mapping[str, Array]
    tilt: Mapping[tuple[str, bool], float]
    shift: Mapping[tuple[str, bool], float]
    rise: Mapping[tuple[str, bool], float]
    hysteresis: float
    lag: float
    narrower: Mapping[tuple[bool, int], float]  # m, by set and index of the pass

    def expected(self, c: Crossing) -> Array | None:
        """(k,) m along ``n``: where the solution has the edges of a pass that was read with its delay.

        The equation of :mod:`calibration.tool_frame.bounds`, solved for ``y``.
        """
        key = (c.source.beam, c.source.current)
        edges = self.edges.get(c.source.beam)
        if edges is None or len(edges) != c.edges:
            return None
        late = 0.5 * np.sign(c.v) * self.hysteresis + 0.5 * c.v * np.where(c.rising, -1.0, 1.0) * self.lag
        edges = edges + self.narrower.get((c.source.current, c.source.index), 0.0) * c.inwards
        b = self.tilt[key]
        found: Array = edges / np.cos(b) - np.tan(b) * (c.above + self.rise[key]) - self.shift[key] + late
        return found


def estimate(scene: ToolFrameScene, measured: LaserResult) -> EdgeEstimate:
    """From a result of kind ``laser``."""
    answer, seen = measured.result, measured.observability
    beams = frames(scene.beams, scene.R, scene.tool)
    turn = answer.drot_flange or [0.0, 0.0, 0.0]
    own = {b: seen.own_tilt_rad.get(b) or 0.0 for b in BEAMS}
    then = turned_axis(beams, scene.R @ scene.tool.axis, own)
    now = rotated(then, scene.R @ np.array(turn))
    moved = scene.R @ np.array(answer.dp_flange)
    tilt, shift, rise = {}, {}, {}
    for b, frame in beams.items():
        tilt[b, False], tilt[b, True] = own[b], seen_turn(frame, now)
        shift[b, False], shift[b, True] = 0.0, float(frame.n @ moved)
        rise[b, False], rise[b, True] = 0.0, float(frame.w @ moved)
    edges = {b: np.array(places, dtype=float) for b, places in seen.edges_m.items()}
    narrower = {(p.set_ == "current", p.index): p.narrower_m or 0.0 for p in measured.residuals.per_pass}
    return EdgeEstimate(edges, tilt, shift, rise, answer.hysteresis_m or 0.0, answer.lag_s or 0.0, narrower)
