"""Corners of one observation, and the way between pixels and ideal coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from cell.devices import Intrinsics
from cell.poses import Array

_BLOCK = 200  # views
_NEWTON, _SHORT = 10, 1e-6  # a step that is so short leaves its square, 1e-12


@dataclass(frozen=True)
class CornerSet:
    """Corners of one observation: target points (m, 3), pixels (m, 2), frames averaged per corner (m,).

    ``start`` is a first guess of T_camera_target, (4, 4), or None.
    """

    points: Array
    corners: Array
    count: Array
    start: Array | None = None


def blocks(n: int) -> list[slice]:
    """Few of n views at a time, so that what is computed of them stays in the processor's cache."""
    return [slice(k, min(k + _BLOCK, n)) for k in range(0, n, _BLOCK)]


def undistort(pixels: Array, camera: Intrinsics) -> Array:
    """Ideal coordinates (n, 2), x/z and y/z, of pixels (n, 2)."""
    fx, fy, cx, cy = camera.K
    seen = (pixels - (cx, cy)) / (fx, fy)
    if not any(camera.dist):
        return np.asarray(seen)
    if any(camera.dist[8:]):
        return _undistort_by_opencv(pixels, camera)
    ideal = seen.T.copy()
    for _ in range(_NEWTON):
        seen_there, (xx, xy, yy) = distorted(ideal, camera)
        u, v = seen_there - seen.T
        step = np.stack([yy * u - xy * v, xx * v - xy * u]) / (xx * yy - xy * xy)
        ideal -= step
        short = np.abs(step).max(axis=0) < _SHORT
        if short.all():
            return ideal.T
    ideal[:, ~short] = _undistort_by_opencv(pixels[~short], camera).T  # the model does not reach them
    return ideal.T


def _undistort_by_opencv(pixels: Array, camera: Intrinsics) -> Array:
    """The same for every model of OpenCV, in twice the time."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
    flat = cv2.undistortPointsIter(
        pixels.reshape(-1, 1, 2), camera.matrix, np.array(camera.dist), None, None, criteria
    )
    return np.asarray(flat, dtype=float).reshape(-1, 2)


def ideal_corners(views: Sequence[CornerSet], camera: Intrinsics) -> list[Array]:
    """Ideal coordinates (m, 2) of the corners of each view."""
    out: list[Array] = []
    for k in blocks(len(views)):
        flat = undistort(np.concatenate([v.corners for v in views[k]]), camera)
        out += np.split(flat, np.cumsum([len(v.corners) for v in views[k]])[:-1])
    return out


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
    _, (xx, xy, yy) = distorted(ideal.T, camera)
    return np.stack([fx * xx, fx * xy, fy * xy, fy * yy], axis=1).reshape(-1, 2, 2)


def distorted(ideal: Array, camera: Intrinsics) -> tuple[Array, tuple[Array, Array, Array]]:
    """Distorted coordinates (2, n) of ideal ones (2, n), and their derivative: xx, xy = yx and yy (n,)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*camera.dist, *([0.0] * (8 - len(camera.dist))))[:8]
    x, y = ideal
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + 3 * r2 * k3)
    if k4 or k5 or k6:
        under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial /= under
        slope = (slope - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / under
    aside = 2.0 * (p1 * y + p2 * x)
    out = ideal * (radial + aside)
    out += np.array([[p2], [p1]]) * r2
    return out, (
        radial + 2.0 * xx * slope + aside + 4.0 * p2 * x,
        2.0 * (xy * slope + p1 * x + p2 * y),
        radial + 2.0 * yy * slope + aside + 4.0 * p1 * y,
    )


def _jacobian_of_opencv(ideal: Array, camera: Intrinsics) -> Array:
    """The same for every model of OpenCV: moving a point at depth 1 sideways moves its ideal coordinate."""
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    _, J = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.dist))
    return np.asarray(J, dtype=float)[:, 3:5].reshape(-1, 2, 2)
