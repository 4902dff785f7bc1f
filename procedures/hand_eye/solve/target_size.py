"""A target of another size than was given, so far off that it must be known before the rest is weighted.

A board that is a few per cent off disagrees with the arm by millimetres. Noise levels that are estimated then
take the board's fault for the arm's, and no prior of a printed sheet reaches that far.
"""

from dataclasses import replace

import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.closed_form import closed_form_X, pairs
from calibration.hand_eye.leave_out import spread_about_mean
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import Measurements, Solution

MOST_OFF = 0.5  # beyond that it is another unit, or another mistake
_LEAST_OFF = 0.008  # less is found with the rest
_POOR_T = 1e-3  # m, of the target's poses: there is nothing to be explained in less
_BETTER = 0.6  # of their spread that may be left


def size_factor(measured: Measurements, solution: Solution) -> float:
    """By which the target is larger than given where that alone explains most of the disagreement, else 1."""
    if any(view is None for view in measured.views):
        return 1.0
    problem = solution.problem
    factor = length_factor(problem)
    if factor is None or not _LEAST_OFF < abs(factor - 1.0) < MOST_OFF:
        return 1.0
    C = problem.C.copy()
    C[:, :3, 3] *= factor
    before, after = _spread(problem), _spread(replace(problem, C=C))
    return factor if before > _POOR_T and after < _BETTER * before else 1.0


def sized(measured: Measurements, factor: float) -> Measurements:
    """With the target ``factor`` times as large."""
    views = [None if v is None else replace(v, points=factor * v.points, start=None) for v in measured.views]
    C = measured.C.copy()
    C[:, :3, 3] *= factor
    motions = measured.motions.copy()
    motions[:, :3, 3] *= factor
    return replace(measured, views=views, C=C, motions=motions)


def _spread(problem: Problem) -> float:
    t, _ = spread_about_mean(problem.target_poses(closed_form_X(problem)), problem.group)
    return float(np.median(t))


def length_factor(problem: Problem) -> float | None:
    """By which the camera's translations are to be multiplied to be the arm's; None when nothing tells.

    In ``A X = X B`` with the rotation of X known, translation of X and factor are linear.
    """
    R = closed_form_X(problem)[:3, :3]
    i, j = pairs(problem.group, 300)
    A, B = problem.G[i] @ se3.inverse(problem.G[j]), problem.C[i] @ se3.inverse(problem.C[j])
    of_t = A[:, :3, :3] - np.eye(3)
    of_factor = -(B[:, :3, 3] @ R.T)[..., None]
    system = np.concatenate([of_t, of_factor], axis=2).reshape(-1, 4)
    wanted = -A[:, :3, 3].ravel()
    weight = np.ones(len(i))
    for _ in range(4):
        w = np.repeat(np.sqrt(weight), 3)
        size = np.linalg.norm(system * w[:, None], axis=0)
        if np.any(size == 0.0):
            return None
        x = np.linalg.lstsq(system * w[:, None] / size, wanted * w, rcond=None)[0] / size
        off = np.linalg.norm((system @ x - wanted).reshape(-1, 3), axis=1)
        weight = 1.0 / (1.0 + (off / (3.0 * np.median(off) + 1e-12)) ** 2)
    return float(x[3]) if x[3] > 0.0 else None
