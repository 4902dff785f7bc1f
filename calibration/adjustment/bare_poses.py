"""The adjustment of observations that give the target's pose and no corners: arm, gears and poses.

Nothing is known of lens and target then beyond the poses, so they are no unknowns.
"""

import numpy as np

from calibration.adjustment.components import Components
from calibration.adjustment.equations import Equations
from calibration.adjustment.hand_eye import excess_of, observed, solved
from calibration.adjustment.jackknife import Checked, checked, jackknife
from calibration.adjustment.lens_terms import ImageTerms
from calibration.adjustment.mount import Mounted, on_true_arm
from calibration.adjustment.shared_errors import SharedErrors
from calibration.adjustment.unknowns import AdjustedState, ArmKnown, free_scales, unknowns
from calibration.hand_eye.solution import Solution


def adjust_poses(solution: Solution, arm: ArmKnown | SharedErrors | None) -> Mounted:
    """From the observations that ``solution`` of an eye-to-hand set uses, all of one placement.

    Without ``arm`` the flange's poses are taken as an exact arm has them, but for their noise. Of an arm
    whose joints are not known there are :class:`SharedErrors`.
    """
    problem = solution.problem.take(solution.used)
    of = unknowns(problem, np.flatnonzero(solution.used), arm, None, None)
    free = free_scales(arm)
    none = np.zeros(len(of.names))
    components = Components(
        dict(solution.noise.sigma),
        dict.fromkeys(free, 1.0),
        frozenset([*solution.noise.estimated, *free]),
        solution.noise.most,
    )
    n = problem.n
    images = ImageTerms(np.zeros((n, 6, 0)), np.zeros((0, 0)), np.zeros(0))
    state, eq = solved(of, AdjustedState(problem, solution.at, none, none, components), images, estimates=2)
    obs, x0 = observed(of, state, images)
    excess = excess_of(obs, state.components)
    joint = _joint(eq)
    leaving_out = jackknife(obs, state.components, state.components.equations(obs, of.prior, x0), 6)
    opinion: Checked = checked(joint[:6, :6], leaving_out, excess)
    cov = excess * joint
    cov[:6, :6] = opinion.cov
    found = Mounted(state.at.X, state.at.W[0], state.numbers, cov, dict(state.components.scale))
    return on_true_arm(found, arm, state.components)


def _joint(eq: Equations) -> np.ndarray:
    """(12 + a, 12 + a) of X, the one target's pose and the a numbers."""
    cov, own, cross = eq.covariance, eq.local_covariance()[0], eq.local_cross()[0]
    return np.block(
        [
            [cov[:6, :6], cross[:, :6].T, cov[:6, 6:]],
            [cross[:, :6], own, cross[:, 6:]],
            [cov[6:, :6], cross[:, 6:].T, cov[6:, 6:]],
        ]
    )
