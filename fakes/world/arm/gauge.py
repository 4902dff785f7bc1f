"""The base and the flange with which the controller's arm comes nearest to the true one.

An arm whose links and joints are off stands elsewhere than its controller says. What of that is the same in
all poses is no error of the arm: it is another place of its base, and of what is mounted on its flange.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.even_points import even_points
from cell.poses import Array, adjoint, exp_xi, log_xi
from fakes.world.arm.kinematics import JOINTS, Chain
from fakes.world.arm.true_arm import TrueArm

_SPREAD, _SEED = 11, 3  # two to this power joint vectors
_LEVER_M = 0.3  # at which a turn counts as much as a shift
_ROUNDS = 3  # each leaves the square of what it found; factory errors are below 0.01


def serving(believed: Chain, true: TrueArm, ranges: Array) -> tuple[RigidTransform, RigidTransform]:
    """``base`` and ``flange`` for which ``base believed(q) flange`` is ``true(q)`` in the least squares.

    ``q`` are spread evenly over ``ranges`` (6, 2) rad, at most half a turn either way.
    """
    low, high = np.maximum(ranges[:, 0], -np.pi), np.minimum(ranges[:, 1], np.pi)
    Q = low + (high - low) * even_points(JOINTS, _SPREAD, _SEED)
    arm, truly = believed.forward(Q), true.forward(Q)
    scale = np.array([1.0] * 3 + [_LEVER_M] * 3)
    own = np.broadcast_to(np.diag(scale), (len(Q), 6, 6))
    base = flange = RigidTransform.identity()
    for _ in range(_ROUNDS):
        placed = base * arm * flange
        off = (log_xi(placed.inv() * truly) * scale).ravel()
        by_base = adjoint(placed.inv().as_matrix()) * scale[:, None]
        A = np.concatenate([by_base, own], axis=2).reshape(-1, 12)
        x = np.linalg.lstsq(A, off, rcond=None)[0]
        base, flange = exp_xi(x[:6]) * base, flange * exp_xi(x[6:])
    return base, flange
