"""Blunders: found with Tukey's weights, listed with reasons, then left out of a plain solution.

Distances are studentised: a reading that pulls the solution hides its own error, and one that was left out
is judged with the uncertainty of what it did not help to determine.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from calibration.identification.estimator import Fit, Problem, fit
from calibration.identification.noise import TrackerNoise, estimated, first_noise
from cell.poses import Array

_TUKEY = 4.685  # 95 % efficient for normal errors
_ROUNDS = 8
_REWEIGHTED = 5
_SETTLED = 0.1  # of a full weight: the plain solution that follows needs no better
_CHANCE = 1e-3  # of rejecting any good reading of the set
_DOUBT = 1e-3  # ranges alone make weights differ far less
_MEDIAN = 2.366  # median of chi-square with three degrees of freedom


@dataclass(frozen=True, eq=False)
class RobustFit:
    """The plain solution over ``used`` (n,) readings; ``fit`` covers all n, with weight zero for the rest.

    ``distance`` (n,) is how far each reading is off in units of what chance explains, RMS over three axes.
    ``unknowns`` is how many numbers the readings determine, registration included.
    """

    fit: Fit
    noise: TrackerNoise
    used: NDArray[np.bool_]
    distance: Array
    unknowns: float


def robust_fit(problem: Problem, given: Mapping[str, float], start: Fit) -> RobustFit:
    """Solve, find blunders, solve again without them; readings that weigh next to nothing in ``start`` are
    taken to be far off anyhow."""
    range_m, used = problem.range_m, np.ones(problem.n, dtype=bool)
    noise = first_noise(given)
    sigma = noise.sigma(range_m)
    doubted = _doubted(start)
    now = start if doubted else fit(problem, start, sigma**-2.0)
    C = now.covariance(problem.model)
    unknowns = determined(problem, C)
    squared = _distances(now, C, sigma, used)
    if not doubted and _plausible(squared, used, unknowns):
        noise = estimated(noise, now.e, range_m, unknowns)
        squared = squared * (sigma / noise.sigma(range_m)) ** 2
        if np.all(squared < _limit(squared, used, unknowns, trusted=True)):
            return RobustFit(_plain(problem, now, noise, used), noise, used, np.sqrt(squared / 3.0), unknowns)
    now = _tukey(problem, now, noise.sigma(range_m))
    squared = _distances(now, now.covariance(problem.model), noise.sigma(range_m), used)
    used = _with_enough(squared < _limit(squared, used, unknowns, trusted=False), unknowns)
    return _settled(problem, now, noise, used, unknowns)


def _settled(
    problem: Problem, now: Fit, noise: TrackerNoise, used: NDArray[np.bool_], unknowns: float
) -> RobustFit:
    """Plain solutions until the noise that they show confirms which readings are in ``used`` (n,)."""
    range_m = problem.range_m
    tried: list[NDArray[np.bool_]] = []
    for _ in range(_ROUNDS):
        before = noise
        now = _plain(problem, now, noise, used)
        noise = estimated(noise, now.e[:, used], range_m[used], unknowns)
        now = _plain(problem, now, noise, used)
        squared = _distances(now, now.covariance(problem.model), noise.sigma(range_m), used)
        kept = _with_enough(squared < _limit(squared, used, unknowns, trusted=True), unknowns)
        if np.array_equal(kept, used) and noise.close_to(before):
            break
        if any(np.array_equal(kept, old) for old in tried):
            break
        if not np.array_equal(kept, used):
            tried.append(used)
        used = kept
    return RobustFit(now, noise, used, np.sqrt(squared / 3.0), unknowns)


def determined(problem: Problem, cov: Array) -> float:
    """How many numbers the readings determine: each unknown counts by how little the prior is left of it."""
    model = problem.model
    return float(len(cov) - np.sum(np.diag(cov)[: model.size] / model.sd**2))


def _doubted(start: Fit) -> bool:
    return bool(start.weight.min() < _DOUBT * start.weight.max())


def _plain(problem: Problem, now: Fit, noise: TrackerNoise, used: NDArray[np.bool_]) -> Fit:
    weight = used / noise.sigma(problem.range_m) ** 2
    return now if np.array_equal(weight, now.weight) else fit(problem, now, weight)


def _plausible(squared: Array, used: NDArray[np.bool_], unknowns: float) -> bool:
    """Whether the distances (n,) look like noise alone: none is too large, and their tail is not heavy."""
    if np.any(squared > _limit(squared, used, unknowns, trusted=False)):
        return False
    heaviness = float(squared.mean()) / 3.0 * _MEDIAN / max(float(np.median(squared)), 1e-300)
    return bool(heaviness < 1.0 + 3.0 / np.sqrt(len(squared)))


def _tukey(problem: Problem, now: Fit, sigma: Array) -> Fit:
    """A few re-weighted steps with a scale from the median, so that many readings may be wrong."""
    weight, before = sigma**-2.0, np.zeros(problem.n)
    for k in range(_REWEIGHTED):
        squared = np.sum((now.e / sigma) ** 2, axis=0)
        u = squared / max(float(np.median(squared)) / _MEDIAN, 1e-12)
        # distances first: their weights never vanish, so a bad start cannot lock good readings out
        tukey = 1.0 / np.sqrt(1.0 + u) if k < 2 else np.clip(1.0 - u / (3.0 * _TUKEY**2), 1e-9, None) ** 2
        if np.max(np.abs(tukey - before)) < _SETTLED:
            break
        now, before = fit(problem, now, weight * tukey, iterations=1), tukey
    return now


def _distances(now: Fit, C: Array, sigma: Array, used: NDArray[np.bool_]) -> Array:
    """(n,): squared studentised distances of the readings from the solution."""
    J, n = now.J, len(sigma)
    CJ = (C @ J.reshape(len(J), -1)).reshape(J.shape)
    variance = sigma**2
    V = np.empty((n, 3, 3))
    for i in range(3):
        for j in range(i + 1):
            share = np.sum(J[:, i] * CJ[:, j], axis=0)
            V[:, i, j] = V[:, j, i] = np.where(used, -share, share)
        # a reading that alone determines something leaves no residual: it must not look exact
        V[:, i, i] = np.maximum(V[:, i, i] + variance, 1e-3 * variance)
    solved = np.linalg.solve(V, now.e.T[:, :, None])[:, :, 0]
    return np.asarray(np.abs(np.sum(now.e.T * solved, axis=1)))


def _limit(squared: Array, used: NDArray[np.bool_], unknowns: float, trusted: bool) -> float:
    """Largest squared distance that chance explains, scaled where all residuals exceed the noise levels."""
    left = max(3 * int(used.sum()) - unknowns, 3)
    scale = max(1.0, float(np.median(squared[used])) / _MEDIAN)
    if trusted:
        scale = max(scale, float(squared[used].mean()) / 3.0)
    return scale * 3.0 * float(fdtri(3.0, left, 1.0 - _CHANCE / max(len(squared), 1)))


def _with_enough(used: NDArray[np.bool_], unknowns: float) -> NDArray[np.bool_]:
    """``used``, or everything when fewer than half would be left: then the data, not some, are wrong."""
    count = int(used.sum())
    return used if count >= (len(used) + 1) // 2 and 3 * count >= unknowns + 6 else np.ones_like(used)
