"""Whether the data could tell poses in another order, or of the other setup, from those that were given.

On a regular cone before one placement they cannot: turning the whole cone by a step, or reading it in the
other sense, is a rigid motion that X and the target's pose take up without residual.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.closed_form import closed_form_X
from calibration.hand_eye.leave_out import spread_about_mean
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import Solution
from cell.poses import Array
from procedures.hand_eye.solve.other_order import angles

CODE = "poses.order-unchecked"
_AS_WELL = 2.0  # times the spread of the target: noise alone makes two fits differ by less
_FLOOR_T, _FLOOR_R = 1e-5, 1e-5  # m, rad; below that every arm is perfect
_MOST_POSES = 100  # more are no cone, and the comparison takes the square of them


def order_warnings(solution: Solution) -> list[tuple[str, str]]:
    """A warning with a fixed code when another order or the other setup explains the data as well."""
    problem = solution.problem.take(solution.used)
    if problem.groups != 1 or problem.n > _MOST_POSES:
        return []
    t, r = _spread(problem)
    limit_t, limit_r = max(_AS_WELL * t, _FLOOR_T), max(_AS_WELL * r, _FLOOR_R)

    def fits(other: Problem) -> bool:
        found_t, found_r = _spread(other)
        return found_t < limit_t and found_r < limit_r

    which = []
    if any(fits(replace(problem, G=G)) for G in _other_orders(problem, limit_r)):
        which.append("the order of the poses")
    if fits(replace(problem, G=se3.inverse(problem.G))):
        which.append(f"the setup {problem.setup!r}")
    if not which:
        return []
    text = (
        f"{' and '.join(which)} cannot be checked from these data: poses this regular, with one placement of "
        "the target, fit another one as well; make sure of it, or add poses of other tilt and distance"
    )
    return [(CODE, text)]


def _other_orders(problem: Problem, limit: float) -> Iterator[Array]:
    """Flange poses shifted and reversed, as far as their relative rotations have the camera's angles."""
    n = problem.n
    camera = angles(problem.C)
    arm = angles(problem.G)
    forward = np.arange(n)
    for order in (forward, forward[::-1]):
        for shift in range(n):
            rows = np.roll(order, shift)
            if np.array_equal(rows, forward):
                continue
            off = arm[np.ix_(rows, rows)] - camera
            if float(np.sqrt(np.mean(off**2))) < 2.0 * limit:  # two poses of the spread make one angle
                yield problem.G[rows]


def _spread(problem: Problem) -> tuple[float, float]:
    """RMS distance (m, rad) of the target's poses from their mean, with X in closed form."""
    t, r = spread_about_mean(problem.target_poses(closed_form_X(problem)), problem.group)
    return float(np.sqrt(np.mean(t**2))), float(np.sqrt(np.mean(r**2)))
