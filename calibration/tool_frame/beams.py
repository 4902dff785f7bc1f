"""Where the beams are, from a good tool that crossed each of them at two places: what a reference keeps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.averaging import average, excess, robust
from calibration.tool_frame.beam_lines import FoundBeam, beam_through, plane_gap, point_cov
from calibration.tool_frame.bounds import At, LateralModel, Rows, rows_of, with_speeds
from calibration.tool_frame.centres import out_back
from calibration.tool_frame.crossings import Crossing, PassContents, see
from calibration.tool_frame.geometry import BEAMS, BeamFrame
from calibration.tool_frame.lateral import ROUGH_SPREAD
from calibration.tool_frame.model_choice import TWO_HEIGHTS_M
from calibration.tool_frame.out_and_back import refuse_one_way
from calibration.tool_frame.places import CrossingPlaces
from calibration.tool_frame.posterior import Noise, posterior
from calibration.tool_frame.reference_heights import rough_heights, spot_heights
from calibration.tool_frame.repeatability import of_a_way, scatter_of
from calibration.tool_frame.scene import Refused, ToolFrameScene
from calibration.tool_frame.selection import Selection, marked_near_end, select
from calibration.tool_frame.standstills import in_a_row
from cell.poses import Array

_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class FoundBeams:
    """Both beams and what the passes tell beside them.

    ``plane_gap`` (m) is the height of beam xs over beam ys where they cross seen from above, ``U_plane_gap``
    its 95 % uncertainty. ``cov`` (3, 3) m^2 is that of the tool's point in the beams, in the base: what a
    later comparison with this reference cannot be better than. ``tau`` (s) with ``sigma_tau``;
    ``hysteresis`` (m) and ``lag`` (s) are None where the speeds cannot tell them from ``tau`` and the
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
    scene: ToolFrameScene
    frames: Mapping[str, BeamFrame]
    seen: PassContents
    selection: Selection
    rejected: Mapping[int, str]
    warnings: Sequence[tuple[str, str]]


def find_beams(scene: ToolFrameScene, points: int = 2048) -> FoundBeams:
    """Point and direction of each beam from the reference passes of ``scene``.

    ``scene.beams`` need to be known roughly (some 20 degrees); the tool's point and axis are taken as given
    and the tool as symmetric about its axis across the beams. Raises :class:`Refused`.
    """
    return _Finding(scene, points).run()


class _Finding:
    def __init__(self, scene: ToolFrameScene, points: int) -> None:
        self.scene = scene.take([k for k, p in enumerate(scene.passes) if not p.current])
        self.points = points
        self.lines = dict(scene.beams)
        self.warnings: list[tuple[str, str]] = []

    def run(self) -> FoundBeams:
        tau = 0.0
        for last in range(_ROUNDS):
            scene = replace(self.scene, beams=self.lines)
            found = self._once(scene, tau, final=last == _ROUNDS - 1)
            self.lines = {b: f.line for b, f in found.beams.items()}
            tau = found.tau
        return found

    def _once(self, scene: ToolFrameScene, tau: float, final: bool) -> FoundBeams:
        axis = scene.R @ scene.tool.axis
        frames = geo.frames(scene.beams, scene.R, scene.tool)
        seen = see(scene, frames, tau)
        _check_seen(seen)
        selection = select(scene, seen)
        places = CrossingPlaces(scene, frames)
        met = {k: seen.crossings[k] for k in (*selection.across, *selection.grazing)}
        crossings = marked_near_end({k: met[k] for k in selection.across}, met)
        places.check(crossings)
        refuse_one_way(crossings)
        first = {b: min(places.used(crossings, b)) for b in BEAMS}
        groups = {
            k: "reference" if places.of[k] == first[c.source.beam] else f"{c.source.beam}@{places.of[k]}"
            for k, c in crossings.items()
        }
        model = LateralModel(
            tuple(sorted(set(groups.values()) - {"reference"})),
            (),
            tuple(b for b in BEAMS if places.span(crossings, b) > TWO_HEIGHTS_M),
        )
        model = with_speeds(model, crossings)
        rows, rejected = _without_blunders(crossings, groups, model)
        places.check(crossings)
        mean, cov, noise = self._solved(rows, model, final, crossings)
        value = dict(zip(model.names, mean, strict=False))
        own = {
            b: [len(model.names) + k for k, (name, _) in enumerate(rows.labels) if name == b] for b in BEAMS
        }
        visited = {b: _from_the_first(places, places.used(crossings, b), b, first[b]) for b in BEAMS}
        spots = [(b, j) for b in BEAMS for j in visited[b]]
        if final:
            tilt = {b: value.get(f"own tilt {b}", 0.0) for b in BEAMS}
            scatter = scatter_of(scene.repeatability_m, noise.of_way, noise.spread)
            edges = {b: mean[own[b]] for b in BEAMS}
            heights = spot_heights(scene, frames, seen, places, spots, tilt, edges, scatter, tau)
        else:
            heights = rough_heights(scene, frames, seen, places, spots)
        beams, chords = {}, {}
        for b in BEAMS:
            chords[b] = float(mean[own[b][-1]] - mean[own[b][0]])
            ends, picks = [], np.zeros((2, len(mean)))
            for pick, j in zip(picks, visited[b], strict=True):
                pick[[own[b][0], own[b][-1]]] = 0.5
                if j != first[b]:
                    pick[model.names.index(f"shift {b}@{j}")] -= 1.0
                ends.append((float(places.along[b][j]), *heights.at((b, j))))
            across = np.column_stack([picks @ mean, picks @ cov @ picks.T])
            beams[b] = beam_through(scene, frames[b], ends, across)
        gap, U_gap = plane_gap(beams)
        turn = None
        if all(b in model.own_tilts for b in BEAMS):
            now = geo.turned_axis(frames, axis, {b: value[f"own tilt {b}"] for b in BEAMS})
            turn = scene.R.T @ geo.smallest_turn(axis, now)
        return FoundBeams(
            beams=beams,
            plane_gap=gap,
            U_plane_gap=U_gap,
            cov=point_cov(frames, axis, beams, heights.cov_of([(b, first[b]) for b in BEAMS])),
            tau=float(mean[0]) + tau,
            sigma_tau=float(np.sqrt(cov[0, 0])),
            hysteresis=value.get("hysteresis"),
            lag=value.get("lag"),
            out_back=out_back(scene, crossings, value),
            noise=noise.sigma,
            axis_turn=turn,
            chords=chords,
            scene=scene,
            frames=frames,
            seen=seen,
            selection=selection,
            rejected=rejected,
            warnings=self.warnings,
        )

    def _solved(
        self, rows: Rows, model: LateralModel, final: bool, crossings: Mapping[int, Crossing]
    ) -> tuple[Array, Array, Noise]:
        """Mean and covariance of the unknowns and the edges' places, and the edges' noise."""
        fit = average(rows, model)
        noise = excess(rows, fit.rest, np.ones(len(rows.low)))
        fit = average(rows, model, None, noise)
        if not final:
            return np.concatenate([fit.psi, fit.e]), fit.cov, Noise.usual(noise, ROUGH_SPREAD)
        usual = of_a_way(self.scene.repeatability_m)
        neighbours = in_a_row(dict(enumerate(self.scene.passes)))
        found = posterior(rows, model, fit, noise, self.points, usual_noise=usual, neighbours=neighbours)
        return found.mean, found.cov, found.noise


def _from_the_first(places: CrossingPlaces, used: set[int], beam: str, first: int) -> tuple[int, int]:
    """The first place of a beam and the one farthest from it."""
    along = places.along[beam]
    return first, max(used, key=lambda j: abs(float(along[j] - along[first])))


def _check_seen(seen: PassContents) -> None:
    shown = {c.source.beam for c in seen.crossings.values()}
    if not shown:
        raise Refused("no-edges", "no pass shows the tool breaking a beam and clearing it again")
    if len(shown) < len(BEAMS):
        lost = next(b for b in BEAMS if b not in shown)
        raise Refused("one-beam-only", f"no pass shows the tool in beam {lost}")


def _without_blunders(
    crossings: dict[int, Crossing], groups: Mapping[int, str], model: LateralModel
) -> tuple[Rows, dict[int, str]]:
    """The bounds of those that agree with the others, linearised where they lead to. The rest is taken out
    of ``crossings``, with the reason."""
    rejected: dict[int, str] = {}
    at = At()
    for _ in range(_ROUNDS):
        rows = rows_of(crossings, groups, model, at, {})
        fit, blunder = robust(rows, model)
        for k in set(rows.source[blunder].tolist()):
            worst = float(np.max(np.abs(fit.rest[rows.source == k])))
            rejected[k] = f"disagrees with the other passes: an edge is {1e3 * worst:.3f} mm off"
            del crossings[k]
        value = dict(zip(model.names, fit.psi, strict=True))
        at = At(
            {},
            {b: value[f"own tilt {b}"] for b in model.own_tilts},
            {g: value[f"shift {g}"] for g in model.shifts},
        )
    return rows_of(crossings, groups, model, at, {}), rejected
