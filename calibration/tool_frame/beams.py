"""Where the beams are, from a good tool that crossed each of them at two places: what a reference keeps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.averaging import average, excess, robust
from calibration.tool_frame.crossings import Crossing, Seen, see
from calibration.tool_frame.geometry import BEAMS, BeamFrame
from calibration.tool_frame.height import Bracket, bracket
from calibration.tool_frame.models import TWO_HEIGHTS_M
from calibration.tool_frame.posterior import posterior
from calibration.tool_frame.scene import Line, Refusal, Scene
from calibration.tool_frame.selection import Selection, select
from calibration.tool_frame.system import At, Model, rows_of, several_speeds
from calibration.tool_frame.ways import refuse_one_way
from cell.poses import Array

MIN_APART_M = 0.04
_SAME_PLACE_M = 0.005
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class FoundBeam:
    """One beam. ``line.point`` is where the tool's point meets it at the first place, m in the base;
    ``cov_point`` (3, 3) m^2, ``cov_direction`` (3, 3). ``hit`` (3,) m is the flange there: half-chord centre
    and hit height. ``apart`` (m) is how far the places are apart along it, ``slope`` (rad) its rise against
    base x-y."""

    line: Line
    cov_point: Array
    cov_direction: Array
    hit: Array
    apart: float

    @property
    def slope(self) -> float:
        return float(np.arcsin(np.clip(self.line.direction[2], -1.0, 1.0)))


@dataclass(frozen=True, eq=False)
class FoundBeams:
    """Both beams and what the passes tell beside them.

    ``plane_gap`` (m) is the height of beam xs over beam ys where they cross seen from above, ``U_plane_gap``
    its 95 % uncertainty. ``cov`` (3, 3) m^2 is that of the tool's point in the beams, in the base: what a
    later comparison with this reference cannot be better than. ``tau`` (s) with ``sigma_tau``;
    ``hysteresis`` (m) and ``lag`` (s) are None with one speed, when they cannot be told from ``tau`` and the
    chord. ``out_back`` (m) is, by the places of each pass there and back, the half-chord centre out minus
    back after removing ``tau``; ``noise`` (m) what the edges scatter beyond their intervals. ``axis_turn``
    (3,) rad in the flange is how the axis was found turned against the one that was given, None with one
    height.
    """

    beams: Mapping[str, FoundBeam]
    plane_gap: float
    U_plane_gap: float
    cov: Array
    tau: float
    sigma_tau: float
    hysteresis: float | None
    lag: float | None
    out_back: Mapping[tuple[int, int], float]
    noise: float
    axis_turn: Array | None
    chords: Mapping[str, float]
    scene: Scene
    frames: Mapping[str, BeamFrame]
    seen: Seen
    selection: Selection
    rejected: Mapping[int, str]
    warnings: Sequence[tuple[str, str]]


def find_beams(scene: Scene, points: int = 2048) -> FoundBeams:
    """Point and direction of each beam from the reference passes of ``scene``.

    ``scene.beams`` need to be known roughly (some 20 degrees); the tool's point and axis are taken as given
    and the tool as symmetric about its axis across the beams. Raises :class:`Refusal`.
    """
    return _Finding(scene, points).run()


class _Finding:
    def __init__(self, scene: Scene, points: int) -> None:
        self.scene = scene.take([k for k, p in enumerate(scene.passes) if not p.current])
        self.points = points
        self.lines = dict(scene.beams)
        self.warnings: list[tuple[str, str]] = []

    def run(self) -> FoundBeams:
        tau = 0.0
        for last in range(_ROUNDS):
            scene = Scene(self.scene.R, self.lines, self.scene.tool, self.scene.passes)
            found = self._once(scene, tau, final=last == _ROUNDS - 1)
            self.lines = {b: f.line for b, f in found.beams.items()}
            tau = found.tau
        return found

    def _once(self, scene: Scene, tau: float, final: bool) -> FoundBeams:
        axis = scene.R @ scene.tool.axis
        frames = geo.frames(scene.beams, scene.R, scene.tool)
        seen = see(scene, frames, tau)
        if not seen.crossings:
            raise Refusal("no-edges", "no pass shows the tool breaking a beam and clearing it again")
        shown = {c.source.beam for c in seen.crossings.values()}
        if len(shown) < len(BEAMS):
            lost = next(b for b in BEAMS if b not in shown)
            raise Refusal("one-beam-only", f"no pass shows the tool in beam {lost}")
        selection = select(scene, seen)
        along = self._places(scene, frames)
        crossings = {k: seen.crossings[k] for k in selection.across}
        place = {
            k: self._place(along[scene.passes[k].beam], scene, frames, k) for k in range(len(scene.passes))
        }
        for b in BEAMS:
            visited = {place[k] for k, c in crossings.items() if c.source.beam == b}
            if not visited:
                raise Refusal("too-few-passes", f"no pass across beam {b} can be used")
            if len(visited) < 2 or np.ptp([along[b][j] for j in visited]) < MIN_APART_M:
                raise Refusal(
                    "one-place-only",
                    f"beam {b} was crossed at one place, or at places less than {1e3 * MIN_APART_M:.0f} mm "
                    "apart; its direction is not determined",
                )
        refuse_one_way(crossings)
        first = {b: min(place[k] for k, c in crossings.items() if c.source.beam == b) for b in BEAMS}
        names = {
            k: "reference" if place[k] == first[c.source.beam] else f"{c.source.beam}@{place[k]}"
            for k, c in crossings.items()
        }
        shifts = tuple(sorted({n for n in names.values() if n != "reference"}))
        model = Model(
            shifts,
            (),
            tuple(b for b in BEAMS if self._heights(crossings, place, b) > TWO_HEIGHTS_M),
            several_speeds=several_speeds(list(crossings.values())),
        )
        rejected: dict[int, str] = {}
        at = At()
        for _ in range(_ROUNDS):
            rows = rows_of(crossings, names, model, at, {})
            fit, blunder = robust(rows, model)
            bad = set(rows.source[blunder].tolist())
            for k in bad:
                worst = float(np.max(np.abs(fit.rest[rows.source == k])))
                rejected[k] = f"disagrees with the other passes: an edge is {1e3 * worst:.3f} mm off"
                del crossings[k]
            value = dict(zip(model.names, fit.psi, strict=True))
            at = At(
                {},
                {b: value[f"own tilt {b}"] for b in model.own_tilts},
                {g: value[f"shift {g}"] for g in model.shifts},
            )
        rows = rows_of(crossings, names, model, at, {})
        fit = average(rows, model)
        noise = excess(rows, fit.rest, np.ones(len(rows.low)))
        fit = average(rows, model, None, noise)
        d = len(model.names)
        mean, cov = np.concatenate([fit.psi, fit.e]), fit.cov
        if final:
            found = posterior(rows, model, fit, noise, self.points)
            mean, cov, noise = found.mean, found.cov, found.sigma
        beams, chords = {}, {}
        cov_hit: dict[str, Array] = {}
        for b in BEAMS:
            own = [d + k for k, (name, _) in enumerate(rows.labels) if name == b]
            centre = np.zeros(len(mean))
            centre[[own[0], own[-1]]] = 0.5
            chords[b] = float(mean[own[-1]] - mean[own[0]])
            beams[b], cov_hit[b] = self._beam(
                b, scene, frames, axis, seen, selection, place, along, first, model, mean, cov, centre
            )
        if rejected or len(crossings) < 2:
            for b in BEAMS:
                if not any(c.source.beam == b for c in crossings.values()):
                    raise Refusal("too-few-passes", f"no pass across beam {b} can be used")
        gap, U_gap = _gap(beams)
        turn = None
        if all(b in model.own_tilts for b in BEAMS):
            value = dict(zip(model.names, mean[:d], strict=True))
            now = geo.turned_axis(frames, axis, {b: value[f"own tilt {b}"] for b in BEAMS})
            turn = scene.R.T @ geo.smallest_turn(axis, now)
        value = dict(zip(model.names, mean[:d], strict=True))
        return FoundBeams(
            beams=beams,
            plane_gap=gap,
            U_plane_gap=U_gap,
            cov=self._point_cov(frames, axis, cov_hit),
            tau=float(mean[0]) + tau,
            sigma_tau=float(np.sqrt(cov[0, 0])),
            hysteresis=value.get("hysteresis"),
            lag=value.get("lag"),
            out_back=_out_back(scene, crossings, value),
            noise=noise,
            axis_turn=turn,
            chords=chords,
            scene=scene,
            frames=frames,
            seen=seen,
            selection=selection,
            rejected=rejected,
            warnings=self.warnings,
        )

    # -- places along the beams

    def _tip_along(self, scene: Scene, frames: Mapping[str, BeamFrame], k: int) -> float:
        p = scene.passes[k]
        tip = 0.5 * (p.pose_xyz[0] + p.pose_xyz[-1]) + scene.R @ scene.tool.p
        line = frames[p.beam].line
        return float((tip - line.point) @ line.direction)

    def _places(self, scene: Scene, frames: Mapping[str, BeamFrame]) -> dict[str, Array]:
        """Where along each beam it was crossed, m, in the order in which the places were visited."""
        found = {}
        for b in BEAMS:
            centres: list[float] = []
            own = [k for k, p in enumerate(scene.passes) if p.beam == b]
            for k in sorted(own, key=lambda k: float(scene.passes[k].pose_t[0])):
                a = self._tip_along(scene, frames, k)
                if all(abs(a - c) > _SAME_PLACE_M for c in centres):
                    centres.append(a)
            found[b] = np.array(centres)
        return found

    def _place(self, centres: Array, scene: Scene, frames: Mapping[str, BeamFrame], k: int) -> int:
        return int(np.argmin(np.abs(centres - self._tip_along(scene, frames, k))))

    def _heights(self, crossings: Mapping[int, Crossing], place: Mapping[int, int], beam: str) -> float:
        """Greatest span of heights at one place."""
        spans = [0.0]
        for j in set(place.values()):
            h = [
                float(np.mean(c.above))
                for k, c in crossings.items()
                if c.source.beam == beam and place[k] == j
            ]
            spans.append(float(np.ptp(h)) if h else 0.0)
        return max(spans)

    # -- one beam

    def _beam(
        self,
        b: str,
        scene: Scene,
        frames: Mapping[str, BeamFrame],
        axis: Array,
        seen: Seen,
        selection: Selection,
        place: Mapping[int, int],
        along: Mapping[str, Array],
        first: Mapping[str, int],
        model: Model,
        mean: Array,
        cov: Array,
        centre: Array,
    ) -> tuple[FoundBeam, Array]:
        frame = frames[b]
        used = sorted(
            {place[k] for k in selection.across if scene.passes[k].beam == b},
            key=lambda j: abs(along[b][j] - along[b][first[b]]),
        )
        picked = [used[0], used[-1]]
        points, covs = [], []
        rows = []
        for j in picked:
            row = centre.copy()
            if j != first[b]:
                column = model.column(f"shift {b}@{j}")
                assert column is not None
                row[column] -= 1.0
            rows.append(row)
            height, sigma = self._height(b, scene, frame, selection, place, j)
            a = along[b][j]
            line = frame.line
            points.append(line.point + a * line.direction + float(row @ mean) * frame.n + height * frame.w)
            covs.append(sigma**2)
        lateral = np.stack(rows) @ cov @ np.stack(rows).T
        step = points[1] - points[0]
        length = float(np.linalg.norm(step))
        sign = 1.0 if step @ frame.line.direction > 0.0 else -1.0
        nn, ww = np.outer(frame.n, frame.n), np.outer(frame.w, frame.w)
        side = lateral[0, 0] + lateral[1, 1] - 2.0 * lateral[0, 1]
        beam = FoundBeam(
            line=Line(points[0], sign * step / length),
            cov_point=lateral[0, 0] * nn + covs[0] * ww,
            cov_direction=(side * nn + (covs[0] + covs[1]) * ww) / length**2,
            hit=points[0] - scene.R @ scene.tool.p,
            apart=length,
        )
        return beam, np.array([lateral[0, 0], covs[0]])

    def _height(
        self,
        b: str,
        scene: Scene,
        frame: BeamFrame,
        selection: Selection,
        place: Mapping[int, int],
        j: int,
    ) -> tuple[float, float]:
        """Height of the beam over the line that was given for it, at place ``j``, and its sigma, m."""

        def above(k: int) -> float:
            tip = scene.passes[k].pose_xyz.mean(axis=0) + scene.R @ scene.tool.p
            return float(frame.above(tip[None])[0])

        def own(ks: Sequence[int]) -> dict[int, float]:
            return {k: above(k) for k in ks if scene.passes[k].beam == b and place[k] == j}

        found: Bracket | None = bracket(own(selection.hits), own(selection.missed))
        if found is None:
            raise Refusal(
                "no-height",
                f"no pass goes by above the tool's point at place {j + 1} of beam {b}; it has no height",
            )
        return found.middle, found.sigma

    def _point_cov(self, frames: Mapping[str, BeamFrame], axis: Array, hit: Mapping[str, Array]) -> Array:
        """(3, 3) of the point that both beams together fix, in the base."""
        rows = np.stack([frames["xs"].n, frames["ys"].n, -axis])
        J = np.linalg.inv(rows)
        # The two heights are averaged by their weights.
        z = 1.0 / sum(1.0 / float(hit[b][1]) for b in BEAMS)
        return J @ np.diag([float(hit["xs"][0]), float(hit["ys"][0]), z]) @ J.T


def _gap(beams: Mapping[str, FoundBeam]) -> tuple[float, float]:
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


def _out_back(
    scene: Scene, crossings: Mapping[int, Crossing], value: Mapping[str, float]
) -> dict[tuple[int, int], float]:
    """Half-chord centre out minus back, m, of each pair that follows on another, with the delay removed."""
    found = {}
    order = sorted(crossings, key=lambda k: (scene.passes[k].beam, float(scene.passes[k].pose_t[0])))
    for a, b in pairwise(order):
        p, q = scene.passes[a], scene.passes[b]
        if p.beam == q.beam and p.direction == 1 and q.direction == -1:
            found[a, b] = centre(crossings[a], value) - centre(crossings[b], value)
    return found


def centre(c: Crossing, value: Mapping[str, float]) -> float:
    """Half-chord centre of one pass along ``n``, m, with delay and hysteresis removed."""
    v = float(np.mean(c.v))
    late = v * value["tau"] + 0.5 * float(np.sign(v)) * (value.get("hysteresis") or 0.0)
    return 0.5 * float(c.middle[0] + c.middle[-1]) - late
