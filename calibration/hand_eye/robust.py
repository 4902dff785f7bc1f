"""Blunders: found with Tukey's weights, listed with reasons, then left out of a plain solution."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from calibration.hand_eye.closed_form import closed_form, group_poses
from calibration.hand_eye.noise import Noise, first_noise, reml, weights
from calibration.hand_eye.normal import Linearised, gauss_newton, linearise
from calibration.hand_eye.problem import Estimate, Problem
from cell.poses import Array

_TUKEY = 4.685  # 95 % efficient for normal errors
_CHANCE = 1e-3  # of rejecting any good observation of the set
_MEDIAN = 5.348  # median of chi-square with six degrees of freedom


@dataclass(frozen=True)
class RobustFit:
    """The plain solution over ``used`` (n,) observations. ``distance`` (n,) is how far each is off, in
    units of what its noise explains (RMS over six numbers), also for those left out."""

    lin: Linearised
    noise: Noise
    used: NDArray[np.bool_]
    distance: Array


def robust_fit(problem: Problem, given: Mapping[str, float], start: Estimate | None = None) -> RobustFit:
    """Solve, find blunders, solve again without them; noise levels follow the used observations."""
    start = start or closed_form(problem)
    lin, noise = _tukey(problem, start, given)
    squared = _squared(lin, noise)
    used = squared < _limit(problem, squared, trusted=False)
    for _ in range(8):
        used = _with_enough(problem, used)
        part, at = _restrict(problem, used, lin.at)
        fit = linearise(part, at)
        noise = reml(fit, noise)
        fit = gauss_newton(part, at, weights(fit, noise))
        noise = reml(fit, noise)
        lin = linearise(problem, _widen(problem, used, fit.at))
        squared = _squared(lin, noise)
        again = squared < _limit(part, squared[used], trusted=True)
        if np.array_equal(again, used):
            break
        used = again
    part, at = _restrict(problem, used, lin.at)
    fit = linearise(part, at)
    fit = gauss_newton(part, at, weights(fit, noise))
    return RobustFit(fit, noise, used, np.sqrt(squared / 6.0))


def _squared(lin: Linearised, noise: Noise) -> Array:
    return np.asarray(np.sum(lin.r * (weights(lin, noise) @ lin.r[..., None])[..., 0], axis=1))


def _limit(problem: Problem, squared: Array, trusted: bool) -> float:
    """Largest squared distance that chance explains, scaled where all residuals exceed the noise levels.

    The noise is known from as many residuals as the solution leaves over: hence F and not chi-square.
    """
    left = max(6 * problem.n - 6 - 6 * problem.groups, 6)
    scale = max(1.0, float(np.median(squared)) / _MEDIAN)
    if trusted:
        scale = max(scale, float(squared.sum()) / left)
    return scale * 6.0 * float(f_distribution.isf(_CHANCE / max(problem.n, 1), 6, left))


def _tukey(problem: Problem, at: Estimate, given: Mapping[str, float]) -> tuple[Linearised, Noise]:
    """A few re-weighted solutions with a scale from the median, so that half the data may be wrong."""
    lin = linearise(problem, at)
    noise = first_noise(lin, given)
    for _ in range(5):
        P = weights(lin, noise)
        squared = np.sum(lin.r * (P @ lin.r[..., None])[..., 0], axis=1)
        scale = max(float(np.median(squared)) / _MEDIAN, 1e-12)
        u = squared / scale / (_TUKEY**2 * 6.0)
        tukey = np.where(u < 1.0, (1.0 - u) ** 2, 1e-9)
        lin = gauss_newton(problem, lin.at, P * tukey[:, None, None], iterations=2)
    return lin, noise


def _with_enough(problem: Problem, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``used``, or everything when fewer than half would be left: then the data, not some, are wrong."""
    return used if np.count_nonzero(used) >= max(3, (problem.n + 1) // 2) else np.ones_like(used)


def _restrict(problem: Problem, used: NDArray[np.bool_], at: Estimate) -> tuple[Problem, Estimate]:
    kept = np.unique(problem.group[used])
    return problem.take(used), Estimate(at.X, at.W[kept])


def _widen(problem: Problem, used: NDArray[np.bool_], at: Estimate) -> Estimate:
    """Target poses for all groups; those that lost every observation get the best of their own."""
    W = group_poses(problem, at.X)
    W[np.unique(problem.group[used])] = at.W
    return Estimate(at.X, W)
