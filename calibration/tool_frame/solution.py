"""From passes in memory to the displacement of the tool with its covariance: the one path of everything."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.averaging import Fit, average, excess, robust
from calibration.tool_frame.crossings import Crossing, Seen, see
from calibration.tool_frame.geometry import BEAMS, BeamFrame
from calibration.tool_frame.height import Bracket
from calibration.tool_frame.models import choose_model, groups_of
from calibration.tool_frame.posterior import posterior
from calibration.tool_frame.scene import Refusal, Scene
from calibration.tool_frame.selection import Selection, select
from calibration.tool_frame.system import At, Model, Rows, rows_of
from calibration.tool_frame.vertical import Vertical
from calibration.tool_frame.ways import UNSEEN_DELAY, compared_ways
from calibration.tool_frame.widths import even_widths, unlike_stated
from cell.poses import Array

_ROUNDS = 3
INTERVAL, AVERAGING = "interval", "averaging"
UNKNOWN_HEIGHT_M = 0.01


@dataclass(frozen=True, eq=False)
class Lateral:
    """What the crossings tell. ``mean`` and ``cov`` are of ``model.names`` and then the edges' places.

    ``rows`` were made with positions read ``tau_read`` s before the polls, linearised ``at``, and with
    ``height`` added to those above the beams.
    """

    model: Model
    rows: Rows
    mean: Array
    cov: Array
    sigma: float
    effective: float | None
    fit: Fit
    at: At
    height: Mapping[str, float]
    tau_read: float

    def value(self, name: str) -> float | None:
        k = self.model.column(name)
        return None if k is None else float(self.mean[k])

    def deviation(self, name: str) -> float | None:
        k = self.model.column(name)
        return None if k is None else float(np.sqrt(self.cov[k, k]))

    @property
    def linear(self) -> Array:
        """``mean`` as the rows have it: with the delay that is left after ``tau_read``."""
        found = np.array(self.mean)
        found[[k for k, name in enumerate(self.model.names) if name.startswith("tau")]] -= self.tau_read
        return found

    def edges(self, beam: str) -> Array:
        """(k,) m: the places of the tool's edges at this beam, in their order along ``n``."""
        d = len(self.model.names)
        own = [d + k for k, (name, _) in enumerate(self.rows.labels) if name == beam]
        found: Array = self.mean[own]
        return found


@dataclass(frozen=True, eq=False)
class Solution:
    """The current tool against the reference, in the flange.

    ``dp`` (3,) m is the tool's point now minus then, ``drot`` (3,) the smallest rotation vector that takes
    the axis then to the axis now, None when no tilt was seen. ``cov`` (6, 6) belongs to both, in the flange's
    axes; what is not determined is zero in it (the spin about the axis; all rotation when ``drot`` is None)
    and named in ``undetermined``. ``z_sigma`` is None when nothing tells the height: then the part of ``dp``
    along the axis is zero, and its variance that of ``UNKNOWN_HEIGHT_M``. ``lever`` (m) is, by beam, how far
    up the tool the current passes cross it in the mean: an unseen tilt moves the point by that times itself.
    """

    dp: Array
    drot: Array | None
    cov: Array
    z_sigma: float | None
    lateral: Lateral
    frames: Mapping[str, BeamFrame]
    seen: Seen
    selection: Selection
    rejected: Mapping[int, str]
    brackets: Mapping[tuple[str, bool], Bracket]
    warnings: Sequence[tuple[str, str]] = field(default_factory=tuple)
    undetermined: Sequence[str] = field(default_factory=tuple)
    lever: Mapping[str, float] = field(default_factory=dict)


def solve(scene: Scene, method: str = INTERVAL, points: int = 2048) -> Solution:
    """The displacement of the current tool; raises :class:`Refusal` when the passes cannot tell it.

    ``method`` is ``interval`` (the posterior of the intervals) or ``averaging`` (their middles).
    """
    return _Solving(scene, method, points).run()


class _Solving:
    def __init__(self, scene: Scene, method: str, points: int) -> None:
        self.scene, self.method, self.points = scene, method, points
        self.warnings: list[tuple[str, str]] = []
        self.axis: Array = scene.R @ scene.tool.axis
        self.frames = geo.frames(scene.beams, scene.R, scene.tool)

    def run(self) -> Solution:
        seen = see(self.scene, self.frames)
        selection = self._selected(seen)
        tau = self._rough_delay(seen, selection)
        if abs(tau) > 1e-4:
            seen = see(self.scene, self.frames, tau)
            selection = self._selected(seen)
        vertical = Vertical(self.scene, self.frames, seen, selection)
        self.warnings += vertical.warnings
        rejected = dict(vertical.blunders)
        used = [k for k in selection.across if k not in rejected]
        even, uneven = even_widths({k: seen.crossings[k] for k in used})
        self.warnings += uneven
        crossings, removed = self._without_blunders(even, vertical.height)
        rejected |= removed
        self._check_enough(crossings, {**selection.reasons, **rejected})
        self.ways = compared_ways(crossings)
        self.warnings += self.ways.warnings
        lateral, at = self._lateral(crossings, vertical, tau)
        return self._put_together(lateral, at, vertical, rejected)

    # -- selection

    def _selected(self, seen: Seen) -> Selection:
        if not seen.crossings:
            what = "no pass shows the tool breaking a beam and clearing it again"
            raise Refusal("no-edges", what + _mostly(seen.reasons.values()))
        for current, words in ((False, "reference"), (True, "current")):
            beams = {c.source.beam for c in seen.crossings.values() if c.source.current == current}
            if not beams:
                why = [r for k, r in seen.reasons.items() if self.scene.passes[k].current == current]
                what = f"no {words} pass shows the tool breaking a beam and clearing it"
                raise Refusal("no-edges", what + _mostly(why))
            if len(beams) < len(BEAMS):
                lost = next(b for b in BEAMS if b not in beams)
                raise Refusal(
                    "one-beam-only",
                    f"the {words} passes show the tool in beam {next(iter(beams))} alone; its place "
                    f"across beam {lost} is not seen",
                )
        selection = select(self.scene, seen)
        across = list(selection.across)
        for current in (False, True):
            for beam in BEAMS:
                if self._own(across, beam, current):
                    continue
                grazing = self._own(selection.grazing, beam, current)
                if grazing:
                    across += grazing
                    self.warnings.append(
                        ("laser.grazing", f"beam {beam} was crossed at the tool's very end alone; go deeper")
                    )
        if len(across) != len(selection.across):
            reasons = {k: r for k, r in selection.reasons.items() if k not in across}
            selection = Selection(
                sorted(across), selection.grazing, selection.hits, selection.missed, reasons
            )
        return selection

    def _own(self, places: Sequence[int], beam: str, current: bool) -> list[int]:
        passes = self.scene.passes
        return [k for k in places if passes[k].beam == beam and passes[k].current == current]

    def _check_enough(self, crossings: Mapping[int, Crossing], reasons: Mapping[int, str]) -> None:
        for current, words in ((False, "reference"), (True, "current")):
            for beam in BEAMS:
                if not self._own(list(crossings), beam, current):
                    why = [reasons[k] for k in self._own(list(reasons), beam, current)]
                    raise Refusal(
                        "too-few-passes",
                        f"no {words} pass across beam {beam} can be used; its place there is not determined"
                        + _mostly(why),
                    )

    # -- rough values

    def _rough_delay(self, seen: Seen, selection: Selection) -> float:
        crossings = {k: seen.crossings[k] for k in selection.across}
        if not crossings:
            return 0.0
        model = Model(BEAMS)
        fit, _ = robust(rows_of(crossings, groups_of(crossings), model, At(), {}), model)
        return float(np.clip(fit.psi[0], -0.5, 0.5))

    # -- across the beams

    def _without_blunders(
        self, crossings: Mapping[int, Crossing], height: Mapping[str, float]
    ) -> tuple[dict[int, Crossing], dict[int, str]]:
        """Crossings that agree with the others, and why the rest does not."""
        left, removed = dict(crossings), dict[int, str]()
        for _ in range(_ROUNDS):
            if not left:
                break
            model, _ = choose_model(left, height)
            at = At()
            for _ in range(2):
                rows = rows_of(left, groups_of(left), model, at, height)
                fit, blunder = robust(rows, model)
                at = self._at(model, fit.psi, {})
            if not np.any(blunder):
                break
            for k in set(rows.source[blunder].tolist()):
                worst = float(np.max(np.abs(fit.rest[rows.source == k])))
                removed[k] = f"disagrees with the other passes: an edge is {1e3 * worst:.3f} mm off"
                if self._at_the_tip(left[k], fit, rows):
                    removed[k] = f"met the tip alone: its chord of {1e3 * left[k].chord:.2f} mm is short"
                del left[k]
        return left, removed

    def _at_the_tip(self, c: Crossing, fit: Fit, rows: Rows) -> bool:
        """Whether a pass near the tool's end saw less than its width: no blunder, but the end's shape."""
        own = [k for k, (beam, _) in enumerate(rows.labels) if beam == c.source.beam]
        full = float(fit.e[own[-1]] - fit.e[own[0]])
        return c.chord < full and -float(np.mean(c.above)) < 0.25 * full

    def _at(self, model: Model, psi: Array, along_w: Mapping[str, float]) -> At:
        value = dict(zip(model.names, psi, strict=True))
        return At(
            {b: value[f"tilt {b}"] for b in model.tilts},
            {b: value[f"own tilt {b}"] for b in model.own_tilts},
            {g: value[f"shift {g}"] for g in model.shifts},
            along_w,
        )

    def _lateral(
        self, crossings: Mapping[int, Crossing], vertical: Vertical, tau: float
    ) -> tuple[Lateral, At]:
        height = vertical.height
        model, warnings = choose_model(crossings, height)
        self.warnings += warnings
        groups = groups_of(crossings)
        at = At()
        for _ in range(_ROUNDS):
            rows = rows_of(crossings, groups, model, at, height)
            fit = average(rows, model)
            noise = excess(rows, fit.rest, np.ones(len(rows.low)))
            fit = average(rows, model, None, noise)
            at = self._at(model, fit.psi, {})
            z, _ = vertical.along(at, {})
            moved = vertical.displacement(at, z)
            along_w = {b: float(self.frames[b].w @ moved) for b in BEAMS}
            at = self._at(model, fit.psi, along_w)
        rows = rows_of(crossings, groups, model, at, height)
        found = None if self.method == AVERAGING else posterior(rows, model, fit, noise, self.points)
        if found is None:
            mean, cov, sigma, effective = np.concatenate([fit.psi, fit.e]), fit.cov, noise, None
        else:
            mean, cov, sigma, effective = found.mean.copy(), found.cov, found.sigma, found.effective
            at = self._at(model, mean[: len(model.names)], along_w)
        delays = [k for k, name in enumerate(model.names) if name.startswith("tau")]
        mean = np.array(mean)
        mean[delays] += tau
        return Lateral(model, rows, mean, cov, sigma, effective, fit, at, height, tau), at

    # -- the answer

    def _put_together(
        self, lateral: Lateral, at: At, vertical: Vertical, rejected: Mapping[int, str]
    ) -> Solution:
        unsure = float(np.linalg.norm([lateral.deviation(f"tilt {b}") or 0.0 for b in BEAMS]))
        edges = {b: lateral.edges(b) for b in BEAMS}
        self.warnings += unlike_stated(edges, self.scene.tool.radius)
        bulges = vertical.bulges(edges, at, unsure)
        z, z_sigma = vertical.along(at, bulges)
        model, d = lateral.model, len(lateral.model.names)
        tilted = all(b in model.tilts and b not in model.hints for b in BEAMS)
        x = np.concatenate([lateral.mean[:d], [z]])
        cov = np.zeros((d + 1, d + 1))
        cov[:d, :d] = lateral.cov[:d, :d]
        cov[d, d] = (UNKNOWN_HEIGHT_M if z_sigma is None else z_sigma) ** 2
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
        if z_sigma is None:
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
            z_sigma=z_sigma,
            lateral=lateral,
            frames=self.frames,
            seen=vertical.seen,
            selection=vertical.selection,
            rejected=rejected,
            brackets=vertical.brackets,
            warnings=list(dict.fromkeys(self.warnings)),
            undetermined=undetermined,
            lever=self._levers(vertical.seen, lateral),
        )

    def _levers(self, seen: Seen, lateral: Lateral) -> dict[str, float]:
        used = [seen.crossings[k] for k in sorted(set(lateral.rows.source.tolist()))]
        return {
            b: float(np.mean([-c.above - lateral.height.get(b, 0.0) for c in used if _is(c, b)]))
            for b in BEAMS
        }

    def _pose(self, model: Model, x: Array, tilted: bool) -> Array:
        """(6,) displacement and turn in the flange from the unknowns and, last, the height."""
        value = dict(zip(model.names, x[:-1], strict=True))
        dp = geo.in_base(self.frames, self.axis, {b: value[f"shift {b}"] for b in BEAMS}, float(x[-1]))
        turn = np.zeros(3)
        if tilted:
            now = geo.turned_axis(self.frames, self.axis, {b: value[f"tilt {b}"] for b in BEAMS})
            own = {b: value.get(f"own tilt {b}", 0.0) for b in BEAMS}
            turn = geo.smallest_turn(geo.turned_axis(self.frames, self.axis, own), now)
        return np.concatenate([self.scene.R.T @ dp, self.scene.R.T @ turn])


def _mostly(reasons: Iterable[str]) -> str:
    """The commonest reason for which passes were left out, to end a refusal with; empty without any."""
    found = Counter(reasons).most_common(1)
    return "".join(f"; {count} were left out because: {reason}" for reason, count in found)


def _is(c: Crossing, beam: str) -> bool:
    return c.source.current and c.source.beam == beam
