"""How well a plan will determine X, before anything moves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from calibration.planning.mounting import Mounting
from calibration.planning.plan import PlannedPose
from cell.devices import Intrinsics
from cell.poses import Array, adjoint


@dataclass(frozen=True, eq=False)
class PredictedUncertainty:
    """Expected error of X (T_flange_camera, or T_base_camera for eye-to-hand)."""

    cov: Array  # (6, 6) translation first, right perturbation, m and rad

    @property
    def sigma_t_m(self) -> float:
        """RMS translation error."""
        return float(np.sqrt(np.trace(self.cov[:3, :3])))

    @property
    def sigma_r_rad(self) -> float:
        """RMS rotation error."""
        return float(np.sqrt(np.trace(self.cov[3:, 3:])))

    @property
    def error95_t_m(self) -> float:
        """The length that 95 % of translation errors stay below."""
        return _quantile_of_length(self.cov[:3, :3])

    @property
    def error95_r_rad(self) -> float:
        """The angle that 95 % of rotation errors stay below."""
        return _quantile_of_length(self.cov[3:, 3:])


def predicted_uncertainty(
    poses: Sequence[PlannedPose],
    mounting: Mounting,
    intrinsics: Intrinsics,
    target_points: ArrayLike,
    sigma_px: float,
    sigma_flange_t: float,
    sigma_flange_r: float,
    placements: int = 1,
) -> PredictedUncertainty:
    """Covariance of the maximum-likelihood X, linearised at the plan (the Cramer-Rao bound of these poses).

    Per pose the view ``M = X^-1 F^-1 W`` (eye-to-hand ``X^-1 F W``) is measured with the covariance of
    perspective-n-point on ``target_points`` (m, 3) with ``sigma_px``, and F with ``sigma_flange_t`` (m) and
    ``sigma_flange_r`` (rad) per axis; W is unknown per placement. ``placements`` placements like this one.
    Distortion is left out: it hardly changes what the corners tell.
    """
    flange = np.diag([sigma_flange_t**2] * 3 + [sigma_flange_r**2] * 3)
    J_xx, J_xw, J_ww = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    for pose in poses:
        M = pose.T_camera_target
        from_flange = adjoint(mounting.target_from_flange(M).as_matrix())
        cov = pnp_covariance(M, target_points, intrinsics, sigma_px) + from_flange @ flange @ from_flange.T
        weight = np.linalg.inv(cov)
        G = -adjoint(M.inv().as_matrix())
        J_xx += G.T @ weight @ G
        J_xw += G.T @ weight
        J_ww += weight
    information: Array = placements * (J_xx - J_xw @ np.linalg.solve(J_ww, J_xw.T))
    return PredictedUncertainty(_symmetric_inverse(information))


def pnp_covariance(
    T_camera_target: RigidTransform, target_points: ArrayLike, intrinsics: Intrinsics, sigma_px: float
) -> Array:
    """(6, 6) covariance of ``T_camera_target`` (right perturbation) from corners with ``sigma_px``."""
    p = np.asarray(target_points, dtype=float)
    R = T_camera_target.rotation.as_matrix()
    x, y, z = T_camera_target.apply(p).T
    fx, fy, _, _ = intrinsics.K
    zero = np.zeros_like(z)
    pixel = np.stack(
        [np.stack([fx / z, zero, -fx * x / z**2], axis=1), np.stack([zero, fy / z, -fy * y / z**2], axis=1)],
        axis=1,
    )
    J = pixel @ R @ np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -_skew(p)], axis=2)
    rows = J.reshape(-1, 6)
    cov: Array = sigma_px**2 * np.linalg.inv(rows.T @ rows)
    return cov


def _symmetric_inverse(information: Array) -> Array:
    return np.asarray(np.linalg.inv(0.5 * (information + information.T)), dtype=float)


def _skew(v: Array) -> Array:
    """(n, 3, 3) cross product matrices of ``v`` (n, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - out.swapaxes(1, 2)


def _quantile_of_length(cov: Array, probability: float = 0.95) -> float:
    """Of |x| for normal x: a scaled chi-square with the mean and variance of |x|^2 (Satterthwaite)."""
    mean, half_variance = float(np.trace(cov)), float(np.sum(cov * cov))
    scale = half_variance / mean
    return float(np.sqrt(scale * chdtri(mean / scale, 1.0 - probability)))
