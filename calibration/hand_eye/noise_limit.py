"""Noise beyond what an arm in working order has: believed or held at its limit, as left-out poses decide.

Where attitudes of the flange scatter by more than the limit, two things can be wrong. They may truly scatter
so much; held at the limit they would weigh too much. Or something else is wrong, as a bracket that gives way,
and an attitude that explains every shift makes the answer worse. The data cannot name the cause; which of the
two answers predicts poses better that it did not see they can tell.
"""

from collections.abc import Mapping

import numpy as np

from calibration.hand_eye.leave_out import leave_one_out, pose_distances
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.robust import RobustFit, robust_fit


def fit_within_limits(problem: Problem, given: Mapping[str, float]) -> RobustFit:
    """The robust solution; where a noise level runs into its limit, the better one of with and without."""
    held = robust_fit(problem, given)
    if not held.noise.implausible:
        return held
    free = robust_fit(problem, given, most={})
    return free if prediction_error(problem, free) < prediction_error(problem, held) else held


def prediction_error(problem: Problem, fit: RobustFit) -> float:
    """Mean distance (m) between each target pose and the one that the other observations predict.

    An observation that the solution does not use is judged by the solution.
    """
    apart = [leave_one_out(fit.lin, fit.weight).t]
    groups = np.unique(problem.group[fit.used])
    rows = np.flatnonzero(~fit.used & np.isin(problem.group, groups))
    W = fit.lin.at.W[np.searchsorted(groups, problem.group[rows])]
    apart.append(pose_distances(problem.target_poses(fit.lin.at.X)[rows], W)[0])
    every = np.concatenate(apart)
    return float(every.mean()) if len(every) else np.inf
