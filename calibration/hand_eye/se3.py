"""SE(3) for many poses at once, as (n, 4, 4) matrices.

Vectors are translation first, as everywhere here. Source: Barfoot, State Estimation for Robotics, ch. 7.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array


def matrices(transform: RigidTransform) -> Array:
    """(4, 4) or (n, 4, 4) of a transform."""
    return np.asarray(transform.as_matrix(), dtype=float)


def transforms(T: Array) -> RigidTransform:
    """The transforms of (4, 4) or (n, 4, 4)."""
    return RigidTransform.from_matrix(T)


def hat(v: Array) -> Array:
    """Cross-product matrices (..., 3, 3) of (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def inverse(T: Array) -> Array:
    """Inverses of (..., 4, 4) poses."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def _left_jacobian_terms(angle2: Array) -> tuple[Array, Array, Array]:
    """sin(a)/a, (1 - cos(a))/a^2 and (a - sin(a))/a^3, with series near zero."""
    small = angle2 < 1e-6
    a2 = np.where(small, 1.0, angle2)
    a = np.sqrt(a2)
    sinc = np.where(small, 1.0 - angle2 / 6.0, np.sin(a) / a)
    versine = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(a)) / a2)
    third = np.where(small, 1.0 / 6.0 - angle2 / 120.0, (a - np.sin(a)) / (a2 * a))
    return sinc, versine, third


def exp(xi: Array) -> Array:
    """Poses (..., 4, 4) of (..., 6)."""
    W = hat(xi[..., 3:])
    W2 = W @ W
    sinc, versine, third = (c[..., None, None] for c in _left_jacobian_terms(np.sum(xi[..., 3:] ** 2, -1)))
    eye = np.eye(3)
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., :3, :3] = eye + sinc * W + versine * W2
    out[..., :3, 3] = ((eye + versine * W + third * W2) @ xi[..., :3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def log(T: Array) -> Array:
    """Vectors (..., 6) of poses; rotations up to pi."""
    w = rotation_vectors(T[..., :3, :3])
    W = hat(w)
    angle2 = np.sum(w**2, -1)
    sinc, versine, _ = _left_jacobian_terms(angle2)
    small = angle2 < 1e-6
    safe = np.where(small, 1.0, angle2)
    factor = np.where(small, 1.0 / 12.0 + angle2 / 720.0, (1.0 - sinc / (2.0 * versine)) / safe)
    inv = np.eye(3) - 0.5 * W + factor[..., None, None] * (W @ W)
    return np.concatenate([(inv @ T[..., :3, 3:])[..., 0], w], axis=-1)


def rotation_vectors(R: Array) -> Array:
    """Rotation vectors (..., 3) of rotations (..., 3, 3)."""
    D = R - np.swapaxes(R, -1, -2)
    axis = np.stack([D[..., 2, 1], D[..., 0, 2], D[..., 1, 0]], -1)
    sine = 0.5 * np.sqrt(np.sum(axis**2, -1))
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    small = sine < 1e-6
    w = np.asarray(axis * np.where(small, 0.5, 0.5 * angle / np.where(small, 1.0, sine))[..., None])
    turned = cosine < -0.9  # the axis fades from R - R^T as the angle comes near pi
    if np.any(turned):
        w[turned] = Rotation.from_matrix(R[turned]).as_rotvec()
    return w


def right_jacobian_inverse(xi: Array) -> Array:
    """(..., 6, 6) with ``log(exp(xi) exp(d)) = xi + J d``; series good to 1e-6 for |xi| < 0.5."""
    ad = np.zeros((*xi.shape[:-1], 6, 6))
    ad[..., :3, :3] = ad[..., 3:, 3:] = hat(xi[..., 3:])
    ad[..., :3, 3:] = hat(xi[..., :3])
    ad2 = ad @ ad
    ad *= 0.5
    ad += np.eye(6)
    ad += ad2 / 12.0
    ad -= (ad2 @ ad2) / 720.0
    return ad


def mean_pose(T: Array) -> Array:
    """Karcher mean of the rotations and arithmetic mean of the translations of (n, 4, 4)."""
    out = np.eye(4)
    out[:3, :3] = mean_rotation(T[:, :3, :3])
    out[:3, 3] = T[:, :3, 3].mean(axis=0)
    return out


def mean_rotation(R: Array) -> Array:
    """Karcher mean (3, 3) of (n, 3, 3): the rotation from which the logarithms add up to zero."""
    mean = nearest_rotation(R.sum(axis=0))
    for _ in range(20):
        step = rotation_vectors(mean.T @ R).mean(axis=0)
        mean = mean @ Rotation.from_rotvec(step).as_matrix()
        if np.linalg.norm(step) < 1e-13:
            break
    return mean


def nearest_rotation(M: Array) -> Array:
    """The rotations (..., 3, 3) nearest to matrices, by singular values (Umeyama 1991)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)
