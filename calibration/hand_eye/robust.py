"""Blunders: found with Tukey's weights, listed with reasons, then left out of a plain solution."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from calibration.hand_eye.closed_form import closed_form, group_poses
from calibration.hand_eye.noise import Noise, first_noise, reml, weights
from calibration.hand_eye.normal import Linearised, linearise, minimise, squared_distances
from calibration.hand_eye.problem import Estimate, Problem
from cell.poses import Array

_TUKEY = 4.685  # 95 % efficient for normal errors
_ROUNDS = 8
_FEW = 200  # observations; the levels of more hardly move with the solution that they lead to
_CHANCE = 1e-3  # of rejecting any good observation of the set
_MEDIAN = 5.348  # median of chi-square with six degrees of freedom


@dataclass(frozen=True)
class RobustFit:
    """The plain solution over ``used`` (n,) observations and their weights (k, 6, 6) at it. ``distance`` (n,)
    is how far each is off, in units of what its noise explains (RMS over six numbers), also for those left
    out."""

    lin: Linearised
    noise: Noise
    weight: Array
    used: NDArray[np.bool_]
    distance: Array


def robust_fit(
    problem: Problem,
    given: Mapping[str, float],
    start: Estimate | None = None,
    most: Mapping[str, float] | None = None,
) -> RobustFit:
    """Solve, find blunders, solve again without them; noise levels follow the used observations.

    ``most``: limits of estimated noise levels, unless those of an arm in working order.
    """
    lin, noise = _tukey(problem, start or closed_form(problem), given, most)
    squared = squared_distances(lin.r, weights(lin, noise))
    good = squared < _limit(problem, squared, trusted=False)
    for _ in range(_ROUNDS):
        used = _with_enough(problem, good)
        fit, noise = _plain(_restrict(lin, used), noise)
        lin = fit if used.all() else linearise(problem, _widen(problem, used, fit.at))
        weight = weights(lin, noise)
        squared = squared_distances(lin.r, weight)
        good = squared < _limit(fit.problem, squared[used], trusted=True)
        if np.array_equal(good, used):
            break
    return RobustFit(fit, noise, weight[used], used, np.sqrt(squared / 6.0))


def _plain(lin: Linearised, noise: Noise) -> tuple[Linearised, Noise]:
    """Noise levels and solution of the observations in ``lin``; of few in turn until both agree."""
    for _ in range(2 if lin.problem.n <= _FEW else 1):
        noise = reml(lin, noise)
        lin = minimise(lin, weights(lin, noise))
    return lin, noise


def _limit(problem: Problem, squared: Array, trusted: bool) -> float:
    """Largest squared distance that chance explains, scaled where all residuals exceed the noise levels.

    The noise is known from as many residuals as the solution leaves over: hence F and not chi-square.
    """
    left = max(6 * problem.n - 6 - 6 * problem.groups, 6)
    scale = max(1.0, float(np.median(squared)) / _MEDIAN)
    if trusted:
        scale = max(scale, float(squared.sum()) / left)
    return scale * 6.0 * float(fdtri(6, left, 1.0 - _CHANCE / max(problem.n, 1)))


def _tukey(
    problem: Problem, at: Estimate, given: Mapping[str, float], most: Mapping[str, float] | None
) -> tuple[Linearised, Noise]:
    """A few re-weighted solutions with a scale from the median, so that half the data may be wrong."""
    lin = linearise(problem, at)
    noise = first_noise(lin, given, most)
    for _ in range(3):
        P = weights(lin, noise)
        squared = squared_distances(lin.r, P)
        scale = max(float(np.median(squared)) / _MEDIAN, 1e-12)
        u = squared / scale / (_TUKEY**2 * 6.0)
        tukey = np.where(u < 1.0, (1.0 - u) ** 2, 1e-9)
        lin = minimise(lin, P * tukey[:, None, None], iterations=1)
    return lin, noise


def _with_enough(problem: Problem, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``used``, or everything when fewer than half would be left: then the data, not some, are wrong."""
    return used if np.count_nonzero(used) >= max(3, (problem.n + 1) // 2) else np.ones_like(used)


def _restrict(lin: Linearised, used: NDArray[np.bool_]) -> Linearised:
    if used.all():
        return lin
    at = Estimate(lin.at.X, lin.at.W[np.unique(lin.problem.group[used])])
    return Linearised(lin.problem.take(used), at, lin.r[used], lin.predicted[used], lin.J[used])


def _widen(problem: Problem, used: NDArray[np.bool_], at: Estimate) -> Estimate:
    """Target poses for all groups; those that lost every observation get the best of their own."""
    W = group_poses(problem, at.X)
    W[np.unique(problem.group[used])] = at.W
    return Estimate(at.X, W)
