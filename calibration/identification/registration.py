"""The tracker's place: the rigid motion that brings one set of points to another."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array

_ROUNDS = 12
_NO_BLUNDER = 4.0  # times the median distance


@dataclass(frozen=True, eq=False)
class Registration:
    """``T_tracker_base`` as a rotation ``R`` (3, 3) and a translation ``b`` (3,), m."""

    R: Array
    b: Array

    def to_base(self, p: Array) -> Array:
        """(3, n) from tracker to base."""
        out: Array = self.R.T @ (p - self.b[:, None])
        return out

    def to_tracker(self, f: Array) -> Array:
        """(3, n) from base to tracker."""
        out: Array = self.R @ f + self.b[:, None]
        return out

    def pose(self) -> RigidTransform:
        return RigidTransform.from_components(self.b, Rotation.from_matrix(self.R))


def register(p: Array, f: Array, weight: Array) -> Registration:
    """The motion that takes ``f`` (3, n) closest to ``p`` (3, n), in weighted least squares.

    Singular value decomposition with the guard against reflections (Arun et al. 1987, Umeyama 1991).
    """
    total = weight.sum()
    pc, fc = (p @ weight) / total, (f @ weight) / total
    U, _, Vt = np.linalg.svd(((p - pc[:, None]) * weight) @ (f - fc[:, None]).T)
    side = 1.0 if np.linalg.det(U) * np.linalg.det(Vt) > 0.0 else -1.0
    R = (U * np.array([1.0, 1.0, side])) @ Vt
    return Registration(R, pc - R @ fc)


def robust_register(p: Array, f: Array, weight: Array) -> Registration:
    """As :func:`register`, with the sum of distances instead of squares: gross blunders do not pull it."""
    found = register(p, f, weight)
    for _ in range(_ROUNDS):
        distance = np.sqrt(np.sum((found.to_tracker(f) - p) ** 2, axis=0))
        typical = float(np.median(distance))
        if distance.max() < _NO_BLUNDER * typical:
            break
        found = register(p, f, weight / np.maximum(distance, 0.5 * typical + 1e-12))
    return found
