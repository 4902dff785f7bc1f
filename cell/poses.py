"""Poses as they are written in files and handed between devices.

A pose in a file, register or message is ``[x, y, z, rx, ry, rz]``: translation in metres and rotation
vector (axis times angle) in radians. In code a pose is SciPy's ``RigidTransform``. A pose error is a
6-vector ``xi`` with translation first, applied on the right: ``T = T_hat exp(xi)``.
"""

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

Array = NDArray[np.float64]

_TRANSLATION_FIRST = [3, 4, 5, 0, 1, 2]


@cache
def _scipy() -> Any:
    """SciPy's rotations, which take longer to import than all else that a process of pictures needs."""
    from scipy.spatial import transform

    return transform


def from_pose6(pose: ArrayLike) -> "RigidTransform":
    """``T_a_b`` from ``[x, y, z, rx, ry, rz]``; shape (6,) or (n, 6), metres and radians."""
    p = np.array(pose, dtype=float)  # a copy: SciPy refuses read-only arrays
    if p.shape[-1:] != (6,):
        raise ValueError(f"a pose has 6 numbers x, y, z, rx, ry, rz; got shape {p.shape}")
    matrix = np.zeros((*p.shape[:-1], 4, 4))
    matrix[..., :3, :3] = _scipy().Rotation.from_rotvec(p[..., 3:]).as_matrix()
    matrix[..., :3, 3] = p[..., :3]
    matrix[..., 3, 3] = 1.0
    out: RigidTransform = _scipy().RigidTransform(matrix, normalize=False, copy=False)
    return out


def to_pose6(transform: "RigidTransform") -> Array:
    """``[x, y, z, rx, ry, rz]`` of ``T_a_b``; shape (6,) or (n, 6), metres and radians."""
    matrix = transform.as_matrix()
    # What is in a transform is a rotation already: SciPy's check of that takes five sixths of the time.
    turn = _scipy().Rotation.from_matrix(matrix[..., :3, :3], assume_valid=True)
    return np.concatenate([matrix[..., :3, 3], turn.as_rotvec()], axis=-1)


def compose(first: "RigidTransform", *others: "RigidTransform") -> "RigidTransform":
    """``T_a_b T_b_c ...``, single or n each, in a quarter of the time of SciPy's product.

    That one makes each product orthonormal anew. A few factors do not need it: their rounding is 1e-16 each.
    """
    matrix: Array = first.as_matrix()
    for other in others:
        matrix = matrix @ other.as_matrix()
    out: RigidTransform = _scipy().RigidTransform(matrix, normalize=False)
    return out


def exp_xi(xi: ArrayLike) -> "RigidTransform":
    """SE(3) exponential of ``xi`` = (translation part, rotation part), shape (6,) or (n, 6)."""
    x = np.asarray(xi, dtype=float)
    out: RigidTransform = _scipy().RigidTransform.from_exp_coords(x[..., _TRANSLATION_FIRST])
    return out


def log_xi(transform: "RigidTransform") -> Array:
    """SE(3) logarithm as (translation part, rotation part); inverse of :func:`exp_xi`."""
    coords: Array = transform.as_exp_coords()
    return coords[..., _TRANSLATION_FIRST]


def adjoint(T: Array) -> Array:
    """Ad (..., 6, 6) of poses (..., 4, 4): ``T exp(xi) T^-1 = exp(Ad xi)`` (Barfoot 2017, eq. 7.45)."""
    R, (x, y, z) = T[..., :3, :3], np.moveaxis(T[..., :3, 3], -1, 0)
    skew = np.zeros((*T.shape[:-2], 3, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -z, y, -x
    skew = skew - skew.swapaxes(-1, -2)
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew @ R
    return out
