"""What the crossings tell: the unknowns across the beams and the places of the tool's edges."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame.averaging import AveragingFit, average, excess, of_ways, robust
from calibration.tool_frame.bounds import At, LateralModel, Rows, rows_of
from calibration.tool_frame.crossings import Crossing, PassContents
from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.model_choice import choose_model, groups_of
from calibration.tool_frame.posterior import Noise, posterior
from calibration.tool_frame.repeatability import of_a_way
from calibration.tool_frame.selection import Selection
from calibration.tool_frame.standstills import in_a_row, of_edges
from calibration.tool_frame.vertical import Vertical
from cell.poses import Array

INTERVAL, AVERAGING = "interval", "averaging"
ROUGH_SPREAD = 0.5  # of noise that averaging finds
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Lateral:
    """What the crossings tell. ``mean`` and ``cov`` are of ``model.names`` and then the edges' places;
    ``noise`` is that of edges.

    ``rows`` were made with positions read ``tau_read`` s before the polls, linearised ``at``, and with
    ``height`` added to those above the beams.
    """

    model: LateralModel
    rows: Rows
    mean: Array
    cov: Array
    noise: Noise
    effective: float | None
    fit: AveragingFit
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

    @property
    def narrower(self) -> dict[int, float]:
        """m, by place in the scene: by how much less each edge of a pass near the tool's end is out."""
        found = {}
        for name in self.model.near_ends:
            k = self.model.names.index(f"narrower {name}")
            found.update(
                dict.fromkeys(self.rows.source[self.rows.X[:, k] != 0.0].tolist(), float(self.mean[k]))
            )
        return found

    def edges(self, beam: str) -> Array:
        """(k,) m: the places of the tool's edges at this beam, in their order along ``n``."""
        d = len(self.model.names)
        own = [d + k for k, (name, _) in enumerate(self.rows.labels) if name == beam]
        found: Array = self.mean[own]
        return found


def rough_delay(seen: PassContents, selection: Selection) -> float:
    """The input's delay (s) by averaging, to read the arm's positions where it was."""
    crossings = {k: seen.crossings[k] for k in selection.across}
    if not crossings:
        return 0.0
    model = LateralModel(BEAMS)
    fit, _ = robust(rows_of(crossings, groups_of(crossings), model, At(), {}), model)
    return float(np.clip(fit.psi[0], -0.5, 0.5))


def without_blunders(
    crossings: Mapping[int, Crossing], height: Mapping[str, float]
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
            at = _at(model, fit.psi, {})
        if not np.any(blunder):
            break
        for k in set(rows.source[blunder].tolist()):
            worst = float(np.max(np.abs(fit.rest[rows.source == k])))
            removed[k] = f"disagrees with the other passes: an edge is {1e3 * worst:.3f} mm off"
            if _at_the_tip(left[k], fit, rows):
                removed[k] = f"met the tip alone: its chord of {1e3 * left[k].chord:.2f} mm is short"
            del left[k]
    return left, removed


def _at_the_tip(c: Crossing, fit: AveragingFit, rows: Rows) -> bool:
    """Whether a pass near the tool's end saw less than its width: no blunder, but the end's shape."""
    own = [k for k, (beam, _) in enumerate(rows.labels) if beam == c.source.beam]
    full = float(fit.e[own[-1]] - fit.e[own[0]])
    return c.chord < full and -float(np.mean(c.above)) < 0.25 * full


def _at(model: LateralModel, psi: Array, along_w: Mapping[str, float]) -> At:
    value = dict(zip(model.names, psi, strict=True))
    return At(
        {b: value[f"tilt {b}"] for b in model.tilts},
        {b: value[f"own tilt {b}"] for b in model.own_tilts},
        {g: value[f"shift {g}"] for g in model.shifts},
        along_w,
    )


def solve_lateral(
    crossings: Mapping[int, Crossing], vertical: Vertical, tau: float, method: str, points: int
) -> tuple[Lateral, At, list[tuple[str, str]]]:
    """What ``crossings``, read ``tau`` s before the polls, tell; where they were linearised; and warnings."""
    height = vertical.height
    model, warnings = choose_model(crossings, height, vertical.scene.tool.axis_known)
    groups = groups_of(crossings)
    at = At()
    for _ in range(_ROUNDS):
        rows = rows_of(crossings, groups, model, at, height)
        fit = average(rows, model)
        noise = excess(rows, fit.rest, np.ones(len(rows.low)))
        fit = average(rows, model, None, noise)
        at = _at(model, fit.psi, {})
        moved = vertical.displacement(at, vertical.rough(at))
        along_w = {b: float(vertical.frames[b].w @ moved) for b in BEAMS}
        at = _at(model, fit.psi, along_w)
    rows = rows_of(crossings, groups, model, at, height)
    usual = of_a_way(vertical.scene.repeatability_m)
    neighbours = in_a_row(dict(enumerate(vertical.scene.passes)))
    if method == AVERAGING:
        correlation = of_edges(rows.source, neighbours)
        mean, cov, effective = np.concatenate([fit.psi, fit.e]), of_ways(fit, rows, model, correlation), None
        scatter = Noise.usual(noise, ROUGH_SPREAD)
    else:
        found = posterior(rows, model, fit, noise, points, usual_noise=usual, neighbours=neighbours)
        mean, cov, scatter, effective = found.mean.copy(), found.cov, found.noise, found.effective
        at = _at(model, mean[: len(model.names)], along_w)
    delays = [k for k, name in enumerate(model.names) if name.startswith("tau")]
    mean = np.array(mean)
    mean[delays] += tau
    lateral = Lateral(model, rows, mean, cov, scatter, effective, fit, at, height, tau)
    return lateral, at, warnings
