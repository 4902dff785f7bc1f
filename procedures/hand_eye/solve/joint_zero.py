"""One joint whose zero is off: the camera sees what the controller does not know."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.closed_form import closed_form_X
from calibration.hand_eye.leave_out import spread_about_mean
from calibration.hand_eye.problem import Problem
from calibration.kinematics.parametric import ParametricArm
from cell.poses import Array
from procedures.hand_eye.solve.other_writing import LEVER_M

CODE = "joints.zero"
MOST = 0.6  # rad, that are searched
LEAST = 3e-3  # rad; less is what an arm in working order may have
_STEPS = 25
_BETTER = 0.5  # of the disagreement that may be left
_UNLIKE = 0.8  # of what the next joint leaves; otherwise the two are not told apart


@dataclass(frozen=True)
class ZeroOffset:
    """Joint ``j`` (from 0) is ``offset`` rad from where it is told to be; ``flange`` (n, 4, 4) then."""

    j: int
    offset: float
    flange: Array
    text: str


def best_offset(
    disagreement: Callable[[Array], float], joints: int, searched: Sequence[int]
) -> tuple[int, float] | None:
    """The one joint and its offset (rad) that leave the least; None when no joint alone explains it.

    ``disagreement`` is asked for offsets (j,) of all joints; those not in ``searched`` do not change it.
    """
    start = disagreement(np.zeros(joints))
    left = np.full(joints, start)
    from scipy.optimize import minimize_scalar  # 12 MB that a good set has no use for

    offsets = np.zeros(joints)
    grid = np.linspace(-MOST, MOST, _STEPS)
    for j in searched:

        def of(offset: float, j: int = j) -> float:
            return disagreement(offset * np.eye(joints)[j])

        values = [of(float(g)) for g in grid]
        k = int(np.argmin(values))
        step = grid[1] - grid[0]
        found = minimize_scalar(of, bounds=(grid[k] - step, grid[k] + step), method="bounded")
        left[j], offsets[j] = float(found.fun), float(found.x)
    first, second = np.argsort(left)[:2]
    if left[first] > _BETTER * start or left[first] > _UNLIKE * left[second] or abs(offsets[first]) < LEAST:
        return None
    return int(first), float(offsets[first])


def joint_zero(problem: Problem, arm: ParametricArm, Q: Array) -> ZeroOffset | None:
    """The joint whose offset makes the images agree.

    Of an arm whose joints turn one link each, the first and the last one are not searched: what they turn
    is the base, or what the flange carries, and the answer takes that up whole.
    """
    told = arm.base.flange(Q)
    given = problem.G if problem.setup == "eye-to-hand" else se3.inverse(problem.G)
    tool = se3.inverse(told) @ given

    def moved(offsets: Array) -> Array:
        return np.asarray(arm.base.flange(Q + offsets) @ tool)

    def disagreement(offsets: Array) -> float:
        F = moved(offsets)
        now = replace(problem, G=F if problem.setup == "eye-to-hand" else se3.inverse(F))
        t, r = spread_about_mean(now.target_poses(closed_form_X(now)), now.group)
        return float(np.median(t) + LEVER_M * np.median(r))

    joints = Q.shape[1]
    found = best_offset(disagreement, joints, range(1, joints - 1) if arm.base.plain else range(joints))
    if found is None:
        return None
    j, offset = found
    text = (
        f"the images agree when joint {j + 1} stands {np.degrees(offset):+.2f} deg from where q has it: its "
        "zero is lost; set it anew at the robot, and record the set again"
    )
    return ZeroOffset(j, offset, moved(offset * np.eye(Q.shape[1])[j]), text)
