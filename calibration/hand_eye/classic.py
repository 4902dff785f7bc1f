"""OpenCV's hand-eye solvers, as a cross-check and for comparison.

Tsai and Lenz 1989, Park and Martin 1994, Horaud and Dornaika 1995, Daniilidis 1999. None of them knows how
certain a pose is, and none gives an uncertainty.
"""

import cv2
import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.problem import Problem
from cell.poses import Array

METHODS = {
    "tsai": cv2.CALIB_HAND_EYE_TSAI,
    "park": cv2.CALIB_HAND_EYE_PARK,
    "horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}


def solve_classic(problem: Problem, method: str) -> Array | None:
    """X (4, 4) by one of ``METHODS``, from the largest group (they know one target pose); None if it fails.

    The pairs that they build cost the square of the number of poses.
    """
    sizes = np.bincount(problem.group)
    rows = problem.group == int(np.argmax(sizes))
    gripper, target = se3.inverse(problem.G[rows]), problem.C[rows]
    motions = [list(part) for T in (gripper, target) for part in (T[:, :3, :3], T[:, :3, 3])]
    try:
        R, t = cv2.calibrateHandEye(motions[0], motions[1], motions[2], motions[3], method=METHODS[method])
    except cv2.error:
        return None
    if R is None or not (np.all(np.isfinite(R)) and np.all(np.isfinite(t))):
        return None
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, np.ravel(t)
    return X


def jackknife(problem: Problem, method: str, X: Array, blocks: int = 20) -> Array | None:
    """Covariance (6, 6) of a classic solution, by leaving out one block of poses at a time.

    None when a block's solution fails.
    """
    m = min(blocks, problem.n)
    steps = []
    for k in range(m):
        left = solve_classic(problem.take(np.arange(problem.n) % m != k), method)
        if left is None:
            return None
        steps.append(se3.log(se3.inverse(X) @ left))
    centred = np.stack(steps) - np.mean(steps, axis=0)
    return np.asarray((m - 1) / m * centred.T @ centred)
