"""Base and flange that bring an arm's model nearest to another one of the same arm.

Where an arm stands and what its flange is are no part of its accuracy: two models are compared after the best
base and the best flange.
"""

import numpy as np

from calibration.hand_eye import se3
from cell.poses import Array, adjoint

_LEVER_M = 0.3  # at which a turn counts as much as a shift
_ROUNDS = 3  # Gauss-Newton; each leaves the square of what it found


def base_and_flange(model: Array, true: Array) -> tuple[Array, Array]:
    """``base`` and ``flange`` (4, 4) for which ``base @ model @ flange`` is nearest to ``true``.

    ``model`` and ``true`` are T_base_flange (n, 4, 4) at the same joints; least squares over place and
    rotation.
    """
    base = flange = np.eye(4)
    scale = np.array([1.0] * 3 + [_LEVER_M] * 3)
    own = np.tile(np.diag(scale), (len(model), 1, 1))
    for _ in range(_ROUNDS):
        placed = base @ model @ flange
        off = se3.log(se3.inverse(placed) @ true) * scale
        A = np.concatenate([adjoint(se3.inverse(placed)) * scale[:, None], own], axis=2).reshape(-1, 12)
        # What the normal equations lose in a step the next one finds.
        x = np.linalg.lstsq(A.T @ A, A.T @ off.ravel(), rcond=None)[0]
        base, flange = se3.exp(x[:6]) @ base, flange @ se3.exp(x[6:])
    return base, flange


def apart(model: Array, true: Array) -> Array:
    """(n, 6) how far ``true`` is from ``model`` after the best base and flange: m and rad, in the flange."""
    base, flange = base_and_flange(model, true)
    out: Array = se3.log(se3.inverse(base @ model @ flange) @ true)
    return out
