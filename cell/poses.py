"""Poses as they are written in files and handed between devices.

A pose in a file, register or message is ``[x, y, z, rx, ry, rz]``: translation in metres and rotation
vector (axis times angle) in radians. In code a pose is SciPy's ``RigidTransform``. A pose error is a
6-vector ``xi`` with translation first, applied on the right: ``T = T_hat exp(xi)``.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

Array = NDArray[np.float64]
Pose6 = Sequence[float]

_TRANSLATION_FIRST = [3, 4, 5, 0, 1, 2]


def from_pose6(pose: ArrayLike) -> RigidTransform:
    """``T_a_b`` from ``[x, y, z, rx, ry, rz]``; shape (6,) or (n, 6), metres and radians."""
    p = np.array(pose, dtype=float)  # a copy: SciPy refuses read-only arrays
    if p.shape[-1:] != (6,):
        raise ValueError(f"a pose has 6 numbers x, y, z, rx, ry, rz; got shape {p.shape}")
    return RigidTransform.from_components(p[..., :3], Rotation.from_rotvec(p[..., 3:]))


def to_pose6(transform: RigidTransform) -> Array:
    """``[x, y, z, rx, ry, rz]`` of ``T_a_b``; shape (6,) or (n, 6), metres and radians."""
    return np.concatenate([transform.translation, transform.rotation.as_rotvec()], axis=-1)


def exp_xi(xi: ArrayLike) -> RigidTransform:
    """SE(3) exponential of ``xi`` = (translation part, rotation part), shape (6,) or (n, 6)."""
    x = np.asarray(xi, dtype=float)
    return RigidTransform.from_exp_coords(x[..., _TRANSLATION_FIRST])


def log_xi(transform: RigidTransform) -> Array:
    """SE(3) logarithm as (translation part, rotation part); inverse of :func:`exp_xi`."""
    coords: Array = transform.as_exp_coords()
    return coords[..., _TRANSLATION_FIRST]
