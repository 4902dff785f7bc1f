"""Two hand-eye calibrations against each other."""

import numpy as np

from cell.errors import error
from cell.poses import adjoint, from_pose6, log_xi
from procedures.hand_eye.result import HandEyeResult
from procedures.pose_comparison import PoseComparison, require_covariances, weighed


def compare_hand_eye(first: HandEyeResult, second: HandEyeResult) -> PoseComparison:
    """``ARGUMENT_INVALID`` for results without covariance, or of different poses."""
    cov_a, cov_b = require_covariances(first.result.cov, second.result.cov)
    held_a, held_b = first.result.pose(), second.result.pose()
    if held_a is None or held_b is None:
        raise error("ARGUMENT_INVALID", "a hand-eye result without a pose cannot be compared")
    (name, pose_a), (other, pose_b) = held_a, held_b
    if name != other:
        raise error("ARGUMENT_INVALID", f"one run holds {name}, the other {other}")
    a, b = from_pose6(pose_a), from_pose6(pose_b)
    between = a.inv() * b
    # An error exp(e) on the right of T_first is exp(-Ad(between^-1) e) on the right of the difference.
    carried = adjoint(between.inv().as_matrix())
    return weighed(name, "", log_xi(between), carried @ cov_a @ carried.T + cov_b, np.eye(6))
