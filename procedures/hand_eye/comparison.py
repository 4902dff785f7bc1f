"""Two hand-eye calibrations against each other."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cell.errors import error
from cell.poses import adjoint, from_pose6, log_xi
from procedures.hand_eye.words import calibration_name
from procedures.pose_comparison import PoseComparison, require_covariances, weighed


def compare_hand_eye(first: Mapping[str, Any], second: Mapping[str, Any]) -> PoseComparison:
    """``ARGUMENT_INVALID`` for results without covariance, or of different poses."""
    require_covariances(first, second)
    answers = first["result"], second["result"]
    names = [calibration_name(answer) for answer in answers]
    if None in names:
        raise error("ARGUMENT_INVALID", "a hand-eye result without a pose cannot be compared")
    if names[0] != names[1]:
        raise error("ARGUMENT_INVALID", f"one run holds {names[0]}, the other {names[1]}")
    a, b = (from_pose6(answer[names[0]]) for answer in answers)
    between = a.inv() * b
    # An error exp(e) on the right of T_first is exp(-Ad(between^-1) e) on the right of the difference.
    carried = adjoint(between.inv().as_matrix())
    cov_a, cov_b = (np.array(answer["cov"]) for answer in answers)
    return weighed(str(names[0]), "", log_xi(between), carried @ cov_a @ carried.T + cov_b, np.eye(6))
