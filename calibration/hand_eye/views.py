"""Corners of one observation, and the way between pixels and ideal coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from cell.devices import Intrinsics
from cell.poses import Array


@dataclass(frozen=True)
class CornerSet:
    """Corners of one observation: target points (m, 3), pixels (m, 2), frames averaged per corner (m,).

    ``start`` is a first guess of T_camera_target, (4, 4), or None.
    """

    points: Array
    corners: Array
    count: Array
    start: Array | None = None


def undistort(pixels: Array, camera: Intrinsics) -> Array:
    """Ideal coordinates (n, 2), x/z and y/z, of pixels (n, 2)."""
    if not any(camera.dist):
        fx, fy, cx, cy = camera.K
        return (pixels - (cx, cy)) / (fx, fy)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
    flat = cv2.undistortPointsIter(
        pixels.reshape(-1, 1, 2), camera.matrix, np.array(camera.dist), None, None, criteria
    )
    return np.asarray(flat, dtype=float).reshape(-1, 2)


def ideal_corners(views: Sequence[CornerSet], camera: Intrinsics) -> list[Array]:
    """Ideal coordinates (m, 2) of the corners of each view."""
    if not views:
        return []
    flat = undistort(np.concatenate([v.corners for v in views]), camera)
    return np.split(flat, np.cumsum([len(v.corners) for v in views])[:-1])


def project(ideal: Array, camera: Intrinsics) -> Array:
    """Pixels (n, 2) of ideal coordinates (n, 2)."""
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.dist))
    return np.asarray(pixels, dtype=float).reshape(-1, 2)


def distortion_jacobian(ideal: Array, camera: Intrinsics) -> Array:
    """d pixel / d ideal coordinate, (n, 2, 2)."""
    fx, fy, _, _ = camera.K
    if not any(camera.dist):
        return np.broadcast_to(np.diag([fx, fy]), (len(ideal), 2, 2))
    if any(camera.dist[8:]):
        return _jacobian_of_opencv(ideal, camera)
    k1, k2, p1, p2, k3, k4, k5, k6 = (*camera.dist, *([0.0] * (8 - len(camera.dist))))[:8]
    x, y = ideal.T
    r2 = x * x + y * y
    over, under = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = over / under
    slope = (k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / under
    mixed = 2 * (x * y * slope + p1 * x + p2 * y)
    out = np.empty((len(ideal), 2, 2))
    out[:, 0, 0] = fx * (radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x)
    out[:, 0, 1], out[:, 1, 0] = fx * mixed, fy * mixed
    out[:, 1, 1] = fy * (radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x)
    return out


def _jacobian_of_opencv(ideal: Array, camera: Intrinsics) -> Array:
    """The same for every model of OpenCV: moving a point at depth 1 sideways moves its ideal coordinate."""
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    _, J = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.dist))
    return np.asarray(J, dtype=float)[:, 3:5].reshape(-1, 2, 2)
