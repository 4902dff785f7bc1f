"""The hand-eye problem in one form for both setups.

``C_i = X^-1 G_i W_g`` with C_i = T_camera_target. Eye-in-hand: G = T_flange_base, X = T_flange_camera,
W = T_base_target. Eye-to-hand: G = T_base_flange, X = T_base_camera, W = T_flange_target. One W per group
(placement of the target). The residual is ``r_i = log(C_i (X^-1 G_i W_g)^-1)``, a perturbation in the
camera frame.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from cell.poses import Array, adjoint

Setup = Literal["eye-in-hand", "eye-to-hand"]
Groups = NDArray[np.int64]


@dataclass(frozen=True)
class Problem:
    """n observations: ``G`` and ``C`` (n, 4, 4), ``group`` (n,) counting from 0.

    ``cov_px`` (n, 6, 6) is the covariance of C in the camera frame for 1 px of corner noise, zero where an
    observation is a bare pose; ``sse`` and ``dof`` are the squared pixel residuals and what is left over
    after the pose took six of them.
    """

    setup: Setup
    G: Array
    C: Array
    group: Groups
    cov_px: Array
    sse: Array
    dof: Array

    @property
    def n(self) -> int:
        return len(self.G)

    @property
    def groups(self) -> int:
        return int(self.group.max()) + 1 if self.n else 0

    @property
    def flange(self) -> Array:
        """T_base_flange (n, 4, 4)."""
        return self.G if self.setup == "eye-to-hand" else se3.inverse(self.G)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> "Problem":
        """The problem of some observations; groups that lose all are renumbered away."""
        _, group = np.unique(self.group[rows], return_inverse=True)
        return replace(
            self,
            G=self.G[rows],
            C=self.C[rows],
            group=group.astype(np.int64),
            cov_px=self.cov_px[rows],
            sse=self.sse[rows],
            dof=self.dof[rows],
        )

    def target_poses(self, X: Array) -> Array:
        """W of each observation alone, ``G^-1 X C`` (n, 4, 4): in the base, or in the flange."""
        return se3.inverse(self.G) @ X @ self.C


@dataclass(frozen=True)
class Estimate:
    """``X`` (4, 4) and the target poses ``W`` (g, 4, 4)."""

    X: Array
    W: Array

    def moved(self, delta: Array) -> "Estimate":
        """By (1 + g, 6): X first, then each W, perturbations on the right."""
        steps = se3.exp(delta)
        return Estimate(self.X @ steps[0], self.W @ steps[1:])


def residuals(problem: Problem, at: Estimate) -> tuple[Array, Array]:
    """Residuals (n, 6) and the predicted T_camera_target (n, 4, 4)."""
    predicted = se3.inverse(at.X) @ problem.G @ at.W[problem.group]
    return se3.log(problem.C @ se3.inverse(predicted)), predicted


def jacobians(r: Array, predicted: Array) -> tuple[Array, Array]:
    """d r / d X and d r / d W of the own group, each (n, 6, 6), for perturbations on the right.

    ``C_pred^-1`` becomes ``exp(-w) C_pred^-1 exp(x)``, so r moves by ``Jr^-1(r) (x - Ad(C_pred) w)``.
    """
    J = se3.right_jacobian_inverse(r)
    return J, -J @ adjoint(predicted)


def flange_adjoint(problem: Problem, at: Estimate, predicted: Array) -> Array:
    """(n, 6, 6) that carries a perturbation on the right of T_base_flange into the camera frame."""
    if problem.setup == "eye-in-hand":
        return np.broadcast_to(adjoint(se3.inverse(at.X)), (problem.n, 6, 6))
    return adjoint(predicted @ se3.inverse(at.W[problem.group]))
