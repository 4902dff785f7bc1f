"""Judged by readings that the solution did not see: nominal, registered only, and calibrated.

Poses are dealt to the folds in turn, with all readings that were made there; each fold is predicted by an arm
solved from the others alone. Where that leaves too few others, poses are judged one at a time.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identification.estimator import Problem, fit
from calibration.identification.observability import pose_numbers
from calibration.identification.registration import Registration, register
from calibration.identification.solution import Solution
from cell.poses import Array

FOLDS = 5
Refit = Callable[[Problem, Array, Array], tuple[Array, Registration]]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Distances (k,) in metres of the judged readings ``rows`` (k,) from where they were predicted.

    ``nominal``: the nominal arm, in the place of the tracker that the calibrated arm found.
    ``registration``: the nominal arm, in the place that suits it best. ``calibrated``: the solved arm.
    """

    rows: NDArray[np.int64]
    nominal: Array
    registration: Array
    calibrated: Array
    folds: int


def held_out(solution: Solution, refit: Refit | None = None) -> HeldOut:
    """K-fold check over the readings in use; folds whose rest is too small even so are left out."""
    problem = solution.problem.take(np.flatnonzero(solution.used))
    return _judged(solution, _dealt(pose_numbers(problem), solution.unknowns + 3), refit)


def by_region(solution: Solution, refit: Refit | None = None) -> HeldOut:
    """The same with a region of the joints' space held out each time: how good the arm is where no pose was.

    Poses dealt in turn leave every one of them with neighbours that were solved with.
    """
    return _judged(solution, _regions(solution.problem.Q[solution.used]), refit)


def _regions(Q: Array) -> NDArray[np.int64]:
    """(n,): which of four regions of equal size joints (n, j) are in, cut where they reach farthest."""
    region = np.zeros(len(Q), dtype=np.int64)
    for _ in range(2):
        halves = np.zeros(len(Q), dtype=np.int64)
        for k in np.unique(region):
            own = np.flatnonzero(region == k)
            along = Q[own, int(np.argmax(np.ptp(Q[own], axis=0)))]
            halves[own] = along > np.median(along)
        region = 2 * region + halves
    return region


def _judged(solution: Solution, fold: NDArray[np.int64], refit: Refit | None) -> HeldOut:
    """Each fold of the readings in use, (n,), predicted by an arm solved from the others."""
    problem, model = solution.problem, solution.model
    used = np.flatnonzero(solution.used)
    sigma = solution.noise.sigma(problem.range_m)
    nominal = model.points(model.nominal, problem.Q, problem.target)
    least = solution.unknowns + 3
    rows, distances = [], []
    for k in np.unique(fold):
        judged, rest = used[fold == k], used[fold != k]
        if 3 * len(rest) < least or _loses_target(problem, judged, rest):
            continue
        part, weight = problem.take(rest), sigma[rest] ** -2.0
        x, place = (refit or _refit)(part, solution.x, weight)
        best = register(part.p, nominal[:, rest], np.ones(len(rest)))
        p = problem.p[:, judged]
        solved = place.to_tracker(model.points(x, problem.Q[judged], problem.target[judged]))
        away = (place.to_tracker(nominal[:, judged]), best.to_tracker(nominal[:, judged]), solved)
        rows.append(judged)
        distances.append([np.sqrt(np.sum((q - p) ** 2, axis=0)) for q in away])
    if not rows:
        none = np.zeros(0)
        return HeldOut(np.zeros(0, dtype=np.int64), none, none, none, 0)
    nominal, registration, calibrated = (np.concatenate([d[i] for d in distances]) for i in range(3))
    return HeldOut(np.concatenate(rows), nominal, registration, calibrated, len(rows))


def _dealt(pose: NDArray[np.int64], least: float) -> NDArray[np.int64]:
    """(n,): the fold of readings at ``pose`` (n,); the others of each must give ``least`` numbers."""
    fold = pose % FOLDS
    largest = int(np.bincount(fold).max(initial=0))
    return pose if 3 * (len(pose) - largest) < least else fold


def _refit(part: Problem, start: Array, weight: Array) -> tuple[Array, Registration]:
    found = fit(part, start, weight, iterations=4)
    return found.x, found.registration


def _loses_target(problem: Problem, judged: NDArray[np.int64], rest: NDArray[np.int64]) -> bool:
    return bool(np.setdiff1d(problem.target[judged], problem.target[rest]).size)


def rms(distance: Array) -> float | None:
    """Root mean square; None of nothing."""
    return float(np.sqrt(np.mean(distance**2))) if len(distance) else None
