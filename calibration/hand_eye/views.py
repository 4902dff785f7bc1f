"""Corners of one observation, and the way between pixels and ideal coordinates."""

from dataclasses import dataclass

import cv2
import numpy as np

from cell.devices import Intrinsics
from cell.poses import Array


@dataclass(frozen=True)
class View:
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
    h = 1e-5
    columns = [
        (project(ideal + step, camera) - project(ideal - step, camera)) / (2 * h) for step in np.eye(2) * h
    ]
    return np.stack(columns, axis=-1)
