"""The delay of a switching input against the arm, from crossings in both directions at several speeds.

An edge that is seen ``tau`` late appears ``v tau`` further along the way; a switch that clears later than it
breaks (hysteresis ``h``) shifts every edge by ``h/2`` along the way, whatever the speed. So the position of
edge k of a tool on a way in direction d = +1 or -1 is ``x = e_k + d (v tau + h/2)``: linear in the places
``e_k``, ``tau`` and ``h``. Two directions tell ``e_k`` from the rest, two speeds tell ``tau`` from ``h``.
The delay of beams falls out of the passes out and back.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from calibration.latency.delay import Delay, DelayUndetermined
from cell.poses import Array

ONE_SPEED = 1.2  # ratio of speeds below which tau and h cannot be told apart
FOLDS = 5


@dataclass(frozen=True)
class SeenCrossing:
    """One edge as it was seen.

    ``place`` numbers the edges of the tool in space, ``direction`` is 1 or -1, ``speed`` (m/s, positive) that
    of the arm, ``x`` (m) where the arm was along the way out when the edge was seen, and ``dt`` (s) half of
    the time that the edge lies in.
    """

    place: int
    direction: int
    speed: float
    x: float
    dt: float

    @property
    def sigma(self) -> float:
        """Standard deviation of ``x``, m: the edge is anywhere in its bracket with equal probability."""
        return self.speed * self.dt / sqrt(3.0)


def undetermined(crossings: Sequence[SeenCrossing]) -> str | None:
    """Why the delay cannot be found from these crossings, beginning with a fixed name, or None."""
    ways = {(c.place, c.direction) for c in crossings}
    places = {c.place for c in crossings}
    if any((p, d) not in ways for p in places for d in (1, -1)) or not places:
        return (
            "one-way: each edge of the tool must be crossed out and back, or the delay is part of its place"
        )
    if len(crossings) < len(places) + 4:
        return f"too-few-passes: {len(crossings)} edges were seen, {len(places) + 4} are needed"
    return None


def solve_delay(crossings: Sequence[SeenCrossing]) -> Delay:
    """Weighted least squares; ``DelayUndetermined`` when :func:`undetermined` says why it cannot be."""
    if (why := undetermined(crossings)) is not None:
        raise DelayUndetermined(why)
    A, x, weight = _system(crossings)
    theta, cov = _fit(A, x, weight)
    residuals = x - A @ theta
    freedom = len(x) - A.shape[1]
    scatter = float(np.sqrt(np.sum((residuals * weight) ** 2) / freedom))
    sigma = np.sqrt(np.diag(cov)) * max(scatter, 1.0)  # brackets are known; what exceeds them is not
    with_h = _several_speeds(crossings)
    tau = A.shape[1] - (2 if with_h else 1)
    return Delay(
        float(theta[tau]),
        float(sigma[tau]),
        float(theta[-1]) if with_h else None,
        float(sigma[-1]) if with_h else None,
        residuals,
        _held_out(A, x, weight),
        scatter,
    )


def _several_speeds(crossings: Sequence[SeenCrossing]) -> bool:
    speeds = [c.speed for c in crossings]
    return max(speeds) > ONE_SPEED * min(speeds)


def _system(crossings: Sequence[SeenCrossing]) -> tuple[Array, Array, Array]:
    """Design (n, places + 1 or 2), positions (n,) m and weights (n,) 1/m."""
    places = sorted({c.place for c in crossings})
    columns = [[float(c.place == p) for c in crossings] for p in places]
    columns.append([c.direction * c.speed for c in crossings])
    if _several_speeds(crossings):
        columns.append([0.5 * c.direction for c in crossings])
    weight = 1.0 / np.array([c.sigma for c in crossings])
    return np.array(columns).T, np.array([c.x for c in crossings]), weight


def _fit(A: Array, x: Array, weight: Array) -> tuple[Array, Array]:
    scale = np.linalg.norm(A * weight[:, None], axis=0)
    W = A * weight[:, None] / scale
    theta, *_ = np.linalg.lstsq(W, x * weight, rcond=None)
    return theta / scale, np.linalg.inv(W.T @ W) / np.outer(scale, scale)


def _held_out(A: Array, x: Array, weight: Array) -> Array:
    """(n,) m: each crossing against a solution without its fold; NaN where the rest cannot tell."""
    out = np.full(len(x), np.nan)
    for fold in range(FOLDS):
        test = np.arange(len(x)) % FOLDS == fold
        if np.linalg.matrix_rank(A[~test]) == A.shape[1]:
            theta, _ = _fit(A[~test], x[~test], weight[~test])
            out[test] = x[test] - A[test] @ theta
    return out
