"""How far beside the middle of a slot a part will be, by cause, before it is inserted.

The slot was seen from one pose of the arm and the part is brought there by another: what the arm errs by in
both alike does no harm. With true poses ``T = T_hat exp(xi)``, of the flange at the look ``a`` and at the
insertion ``b``, of the camera ``x``, of the slot in the camera ``c`` and of the part ``p``, the part is off
its place in the slot by the motion, in the slot's frame,

    e = Ad(D) p + Ad(D P^-1) b - Ad((X C)^-1) a - Ad(C^-1) x - c,

where D is the place of the part's front in the slot, P that in the flange, X the camera's pose and C the
slot's in the camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import erf

from cell.poses import Array, adjoint

SHARE = 0.95
_STEPS = 400


@dataclass(frozen=True)
class Geometry:
    """``T_flange_camera``, ``T_camera_slot`` as seen, ``T_flange_part`` of the part's front, and
    ``T_slot_part``, where that front is to be."""

    T_flange_camera: RigidTransform
    T_camera_slot: RigidTransform
    T_flange_part: RigidTransform
    T_slot_part: RigidTransform


@dataclass(frozen=True)
class Sources:
    """What errs. Covariances (6, 6) of poses, perturbation on the right; of the arm twists of the flange.

    ``camera``, ``part`` and ``detection`` (of the slot in the camera) by their causes, which add up.
    ``arm_look`` and ``arm_insert`` (6, p): how p numbers with covariance ``arm`` (p, p) move the flange at
    both; ``repeat`` (6, 6): what is new at each standstill.
    """

    camera: Mapping[str, Array]
    part: Mapping[str, Array]
    detection: Mapping[str, Array]
    arm_look: Array
    arm_insert: Array
    arm: Array
    repeat: Array


@dataclass(frozen=True)
class Budget:
    """Covariances (2, 2) across the slot's axis by cause, m^2, of the part's front at ``T_slot_part``."""

    by_source: Mapping[str, Array]

    @property
    def cov(self) -> Array:
        return np.asarray(sum(self.by_source.values()))

    @property
    def predicted_95(self) -> float:
        """The distance from the middle, m, that 95 % of insertions stay below."""
        return quantile_radius(self.cov)

    def told(self) -> dict[str, float]:
        """What each cause would give alone: 95 %, m, largest first."""
        alone = {source: quantile_radius(cov) for source, cov in self.by_source.items()}
        return dict(sorted(alone.items(), key=lambda pair: -pair[1]))


def error_budget(at: Geometry, sources: Sources) -> Budget:
    """Of the part's front at its place in the slot."""
    D, P = at.T_slot_part.as_matrix(), at.T_flange_part.as_matrix()
    X, C = at.T_flange_camera.as_matrix(), at.T_camera_slot.as_matrix()
    look = -adjoint(np.linalg.inv(X @ C))
    insert = adjoint(D @ np.linalg.inv(P))
    across = _across(at.T_slot_part.translation)

    def seen(A: Array, cov: Array) -> Array:
        B = across @ A
        return np.asarray(B @ cov @ B.T)

    of_camera = {name: seen(-adjoint(np.linalg.inv(C)), cov) for name, cov in sources.camera.items()}
    of_part = {name: seen(adjoint(D), cov) for name, cov in sources.part.items()}
    of_slot = {name: seen(-np.eye(6), cov) for name, cov in sources.detection.items()}
    arm = seen(insert @ sources.arm_insert + look @ sources.arm_look, sources.arm)
    repeat = seen(insert, sources.repeat) + seen(look, sources.repeat)
    return Budget({**of_camera, "arm model": arm, "arm repeatability": repeat, **of_part, **of_slot})


def quantile_radius(cov: Array, share: float = SHARE) -> float:
    """The radius of the circle that a ``share`` of a centred normal distribution ``cov`` (2, 2) lies in."""
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(cov), 0.0))
    if large == 0.0:
        return 0.0
    angle = ((np.arange(_STEPS) + 0.5) / _STEPS - 0.5) * np.pi
    low, high = 0.0, 6.0 * large
    for _ in range(50):
        r = 0.5 * (low + high)
        u, half = r * np.sin(angle), r * np.cos(angle)  # along the longer axis, and half of the chord there
        chord = erf(half / max(np.sqrt(2.0) * small, 1e-300))
        density = np.exp(-0.5 * (u / large) ** 2) / (np.sqrt(2.0 * np.pi) * large)
        inside = float(np.sum(density * chord * half)) * np.pi / _STEPS
        low, high = (r, high) if inside < share else (low, r)
    return float(0.5 * (low + high))


def _across(at: Array) -> Array:
    """(2, 6): the motion across the slot's axis of the point ``at`` (3,) for a small motion."""
    x, y, z = at
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.hstack([np.eye(3), -skew])[:2]
