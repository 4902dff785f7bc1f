"""From passes in memory to the displacement of the tool with its covariance: the one path of everything."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.apparent_width import even_widths, unlike_stated
from calibration.tool_frame.bounds import At, LateralModel
from calibration.tool_frame.crossings import Crossing, PassContents, see
from calibration.tool_frame.geometry import BEAMS, BeamFrame
from calibration.tool_frame.lateral import INTERVAL, Lateral, rough_delay, solve_lateral, without_blunders
from calibration.tool_frame.out_and_back import UNSEEN_DELAY, compared_ways
from calibration.tool_frame.rise import Heights, Rise
from calibration.tool_frame.scene import ToolFrameScene
from calibration.tool_frame.selection import Selection, marked_near_end
from calibration.tool_frame.sufficiency import check_enough, selected
from calibration.tool_frame.vertical import Vertical
from cell.poses import Array

UNKNOWN_HEIGHT_M = 0.01


@dataclass(frozen=True, eq=False)
class Solution:
    """The current tool against the reference, in the flange.

    ``dp`` (3,) m is the tool's point now minus then, ``drot`` (3,) the smallest rotation vector that takes
    the axis then to the axis now, None when no tilt was seen. ``cov`` (6, 6) belongs to both, in the flange's
    axes; what is not determined is zero in it (the spin about the axis; all rotation when ``drot`` is None)
    and named in ``undetermined``. ``z_sigma`` is None when nothing tells the height: then the part of ``dp``
    along the axis is zero, and its variance that of ``UNKNOWN_HEIGHT_M``. ``heights`` (m) are those of the
    flange at each first contact by beam and set, with their standard deviations, ``scatter_m`` what single
    passes scatter by along the tool, ``ends`` how likely each shape of the tool's end is. ``lever`` (m) is,
    by beam, how far up the tool the current passes cross it in the mean: an unseen tilt moves the point by
    that times itself.
    """

    dp: Array
    drot: Array | None
    cov: Array
    z_sigma: float | None
    lateral: Lateral
    frames: Mapping[str, BeamFrame]
    seen: PassContents
    selection: Selection
    rejected: Mapping[int, str]
    heights: Heights
    scatter_m: float | None
    ends: Mapping[str, float]
    warnings: Sequence[tuple[str, str]] = field(default_factory=tuple)
    undetermined: Sequence[str] = field(default_factory=tuple)
    lever: Mapping[str, float] = field(default_factory=dict)


def solve(scene: ToolFrameScene, method: str = INTERVAL, points: int = 2048) -> Solution:
    """The displacement of the current tool; raises :class:`Refusal` when the passes cannot tell it.

    ``method`` is ``interval`` (the posterior of the intervals) or ``averaging`` (their middles).
    """
    return _Solving(scene, method, points).run()


def solve_across(scene: ToolFrameScene, method: str = INTERVAL, points: int = 2048) -> Lateral:
    """What :func:`solve` finds across the beams, without the displacement along the tool."""
    return _Solving(scene, method, points).across()[0]


class _Solving:
    def __init__(self, scene: ToolFrameScene, method: str, points: int) -> None:
        self.scene, self.method, self.points = scene, method, points
        self.warnings: list[tuple[str, str]] = []
        self.axis: Array = scene.R @ scene.tool.axis
        self.frames = geo.frames(scene.beams, scene.R, scene.tool)

    def run(self) -> Solution:
        return self._put_together(*self.across())

    def across(self) -> tuple[Lateral, At, Vertical, Mapping[int, str]]:
        """What the crossings tell, where they were linearised, the heights of the passes, and which passes
        are not used, with the reason."""
        seen = see(self.scene, self.frames)
        selection, warnings = selected(self.scene, seen)
        tau = rough_delay(seen, selection)
        if abs(tau) > 1e-4:
            seen = see(self.scene, self.frames, tau)
            selection, warnings = selected(self.scene, seen)
        self.warnings += warnings
        vertical = Vertical(self.scene, self.frames, seen, selection)
        self.warnings += vertical.warnings
        rejected = dict(vertical.blunders)
        used = [k for k in selection.across if k not in rejected]
        met = {k: seen.crossings[k] for k in (*used, *selection.grazing) if k not in vertical.blunders}
        even, uneven = even_widths(marked_near_end({k: met[k] for k in used}, met))
        self.warnings += uneven
        crossings, removed = without_blunders(even, vertical.height)
        rejected |= removed
        check_enough(self.scene, crossings, {**selection.reasons, **rejected})
        self.ways = compared_ways(crossings)
        self.warnings += self.ways.warnings
        lateral, at, told = solve_lateral(crossings, vertical, tau, self.method, self.points)
        self.warnings += told
        return lateral, at, vertical, rejected

    def _put_together(
        self, lateral: Lateral, at: At, vertical: Vertical, rejected: Mapping[int, str]
    ) -> Solution:
        rise = Rise(vertical, lateral, at, self.scene.repeatability_m)
        self.warnings += unlike_stated(rise.edges, self.scene.tool.radius)
        up = rise.along()
        model, d = lateral.model, len(lateral.model.names)
        tilted = all(b in model.tilts and b not in model.hints for b in BEAMS)
        x = np.concatenate([lateral.mean[:d], [0.0 if up is None else up.z]])
        cov = np.zeros((d + 1, d + 1))
        cov[:d, :d] = lateral.cov[:d, :d]
        cov[d, d] = UNKNOWN_HEIGHT_M**2
        if up is not None:
            cov[d, :d] = cov[:d, d] = cov[:d, :d] @ up.slope
            cov[d, d] = up.own + up.bend + up.slope @ cov[:d, :d] @ up.slope
        step = np.sqrt(np.diag(cov)) * 1e-3
        J = np.stack(
            [
                (self._pose(model, x + step[k] * e, tilted) - self._pose(model, x - step[k] * e, tilted))
                / (2.0 * step[k])
                for k, e in enumerate(np.eye(d + 1))
            ],
            axis=1,
        )
        pose = self._pose(model, x, tilted)
        full = J @ cov @ J.T
        undetermined = ["spin about the tool's axis"]
        if not tilted:
            undetermined.append(
                "tilt of the tool's axis (the passes of one of the sets span one height only)"
            )
        if not self.ways.delay_seen:
            undetermined.append(UNSEEN_DELAY)
        if up is None:
            undetermined.append("displacement along the tool's axis (no pass goes by above the tool's point)")
            self.warnings.append(
                (
                    "laser.no-height",
                    "nothing tells the height; the displacement along the axis is set to zero",
                )
            )
        return Solution(
            dp=pose[:3],
            drot=pose[3:] if tilted else None,
            cov=0.5 * (full + full.T),
            z_sigma=None if up is None else float(np.sqrt(cov[d, d])),
            lateral=lateral,
            frames=self.frames,
            seen=vertical.seen,
            selection=vertical.selection,
            rejected=rejected,
            heights=rise.heights,
            scatter_m=rise.scatter_m,
            ends=rise.shapes,
            warnings=list(dict.fromkeys(self.warnings)),
            undetermined=undetermined,
            lever=self._levers(vertical.seen, lateral),
        )

    def _levers(self, seen: PassContents, lateral: Lateral) -> dict[str, float]:
        used = [seen.crossings[k] for k in sorted(set(lateral.rows.source.tolist()))]
        return {
            b: float(np.mean([-c.above - lateral.height.get(b, 0.0) for c in used if _is(c, b)]))
            for b in BEAMS
        }

    def _pose(self, model: LateralModel, x: Array, tilted: bool) -> Array:
        """(6,) displacement and turn in the flange from the unknowns and, last, the height."""
        value = dict(zip(model.names, x[:-1], strict=True))
        dp = geo.in_base(self.frames, self.axis, {b: value[f"shift {b}"] for b in BEAMS}, float(x[-1]))
        turn = np.zeros(3)
        if tilted:
            now = geo.turned_axis(self.frames, self.axis, {b: value[f"tilt {b}"] for b in BEAMS})
            own = {b: value.get(f"own tilt {b}", 0.0) for b in BEAMS}
            turn = geo.smallest_turn(geo.turned_axis(self.frames, self.axis, own), now)
        return np.concatenate([self.scene.R.T @ dp, self.scene.R.T @ turn])


def _is(c: Crossing, beam: str) -> bool:
    return c.source.current and c.source.beam == beam
