"""How well the beams will tell where the tool is, before anything moves: from speed, polls and passes.

The passes that are planned are made up with polls at random phases, a few times and always the same, and go
through the estimator itself with the noise as given: no simple formula holds for every number of passes
(averaging has ``v P/sqrt(48)`` for the four edges of one way there and back; intervals that are laid over
each other are better, with many passes by far).
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from calibration.lengths import length95
from calibration.tool_frame.averaging import average
from calibration.tool_frame.bounds import LateralModel, Rows
from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.posterior import posterior
from cell.poses import Array

K95 = 1.96
TYPICAL_RADIUS_M = 0.003
_DRAWS, _POINTS = 10, 512
_EDGES = (-1.0, 1.0)


@dataclass(frozen=True, eq=False)
class ExpectedComparison:
    """Expected covariance of a comparison with a reference that was measured in the same way.

    ``cov`` (5, 5) is of the tool's point in x, y, z (m; along the two beams' normals and the axis) and of the
    tilt about the two beams (rad; zero with one height). ``slide_m`` is how far the tool moves from poll to
    poll.
    """

    cov: Array
    slide_m: float
    tilted: bool

    @property
    def U_xy_m(self) -> float:
        """The length that 95 % of the errors across the beams stay below."""
        return length95(self.cov[:2, :2])

    @property
    def U_z_m(self) -> float:
        return K95 * float(np.sqrt(self.cov[2, 2]))

    @property
    def U_point_m(self) -> float:
        return length95(self.cov[:3, :3])

    @property
    def U_tilt_rad(self) -> float | None:
        return length95(self.cov[3:, 3:]) if self.tilted else None

    @property
    def sigma_xy_m(self) -> float:
        """RMS length of the error across the beams."""
        return float(np.sqrt(np.trace(self.cov[:2, :2])))


@lru_cache(maxsize=64)  # three jobs and the cards of all tools ask for the same ones
def predict(
    speed_m_s: float,
    poll_period_s: float,
    pairs: int,
    z_variance: float,
    depths_m: tuple[float, ...] = (0.006,),
    noise_m: float = 0.0,
    staggered: bool = True,
    reference_pairs: int | None = None,
    first_edge: float = 0.5,
) -> ExpectedComparison:
    """Uncertainty of the tool's displacement from ``pairs`` ways there and back at each of ``depths_m``
    below the point, across each beam.

    ``z_variance`` (m^2) is that of the height, by ``calibration.tool_frame.expected_height``.
    ``noise_m`` is what single ways scatter by in their middle (the arm's repeatability); ``first_edge`` at
    which share of a way the tool meets the beam.
    ``reference_pairs`` when the reference had another number. ``staggered``: the polls of the passes are
    shifted against each other by equal parts of the period.
    """
    rng = np.random.default_rng(4711)
    slide = speed_m_s * poll_period_s
    depths = np.array(depths_m, dtype=float)
    tilted = float(np.ptp(depths)) > 0.0
    model = LateralModel(BEAMS, BEAMS if tilted else (), BEAMS if tilted else ())
    # Near a standstill more of it is left.
    noise = noise_m * float(np.sqrt(2.0) * np.hypot(first_edge, 1.0 - first_edge))
    covs = []
    for _ in range(_DRAWS):
        rows, neighbours = _rows(
            rng,
            model,
            speed_m_s,
            slide,
            (reference_pairs or pairs, pairs),
            depths,
            noise_m,
            first_edge,
            staggered,
        )
        fit = average(rows, model, None, noise)
        known = max(noise, 0.01 * slide)
        found = posterior(rows, model, fit, noise, _POINTS, known, neighbours=neighbours)
        told = _told(model, len(found.cov), tilted)
        covs.append(told @ found.cov @ told.T)
    mean = np.mean(covs, axis=0)
    cov = np.zeros((5, 5))
    place = [0, 1, 3, 4] if tilted else [0, 1]
    cov[np.ix_(place, place)] = mean
    cov[2, 2] = z_variance
    cov.flags.writeable = False
    return ExpectedComparison(cov, slide, tilted)


def _told(model: LateralModel, size: int, tilted: bool) -> Array:
    """(2 or 4, ``size``) from the unknowns to what a comparison tells: where the point is, and how far the
    axis is turned against that of the reference, which is not known either."""
    one, at = np.eye(size), model.names.index
    rows = [one[at(f"shift {b}")] for b in BEAMS]
    if tilted:
        rows += [one[at(f"tilt {b}")] - one[at(f"own tilt {b}")] for b in BEAMS]
    return np.stack(rows)


def _rows(
    rng: np.random.Generator,
    model: LateralModel,
    speed: float,
    slide: float,
    pairs: tuple[int, int],
    depths: Array,
    noise: float,
    first_edge: float,
    staggered: bool,
) -> tuple[Rows, list[tuple[int, int]]]:
    """Made passes, and which of them have a standstill in common."""
    low, high, edge, X, source = [], [], [], [], []
    neighbours: list[tuple[int, int]] = []
    labels = [(b, k) for b in BEAMS for k in range(len(_EDGES))]
    names, place = model.names, 0
    # How the chord falls on the polls is not known before.
    radius = {b: TYPICAL_RADIUS_M + slide * rng.random() for b in BEAMS}
    for current, count in zip((False, True), pairs, strict=True):
        for beam in BEAMS:
            for depth in depths:
                offset = rng.random()
                neighbours += pairwise(range(place, place + 2 * count))
                rest = noise * np.sqrt(2.0) * rng.normal(size=2 * count + 1)
                for k in range(count):
                    for direction in (1.0, -1.0):
                        phase = offset + k / count if staggered else rng.random()
                        phase += 0.0 if direction > 0.0 else rng.random()
                        for j, side in enumerate(_EDGES):
                            share = first_edge if side * direction < 0.0 else 1.0 - first_edge
                            true = side * radius[beam] + float((1.0 - share) * rest[0] + share * rest[1])
                            start = (np.floor(true / slide - phase) + phase) * slide
                            row = np.zeros(len(names))
                            row[0] = direction * speed
                            if current:
                                row[names.index(f"shift {beam}")] = -1.0
                            tilt = f"tilt {beam}" if current else f"own tilt {beam}"
                            if tilt in names:
                                row[names.index(tilt)] = depth
                            low.append(start)
                            high.append(start + slide)
                            edge.append(labels.index((beam, j)))
                            X.append(row)
                            source.append(place)
                        rest = rest[1:]
                        place += 1
    n = len(low)
    made = (np.array(low), np.array(high), np.zeros(n), np.array(edge), np.array(X), np.array(source))
    return Rows(*made, labels), neighbours
