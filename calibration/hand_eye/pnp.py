"""Pose of a target from its corners, for all images at once, with covariance.

Corners are turned into ideal (undistorted) coordinates once; a residual is carried back to pixels by the
local Jacobian of the distortion, which is exact to first order. What is left is a pinhole adjustment of six
numbers per image, done by Gauss-Newton on all images together.
Start values: IPPE (Collins and Bartoli 2014, OpenCV) for planar targets, SQPnP otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from cell.devices import Intrinsics
from cell.poses import Array

Indices = NDArray[np.int64]
MIN_CORNERS = 4
_AMBIGUOUS = 3.0  # a second pose is kept while its squared error is below this times that of the first


@dataclass(frozen=True)
class View:
    """Corners of one observation: target points (m, 3), pixels (m, 2), frames averaged per corner (m,).

    ``start`` is a first guess of T_camera_target, (4, 4), or None.
    """

    points: Array
    corners: Array
    count: Array
    start: Array | None = None


@dataclass(frozen=True)
class Poses:
    """Poses of n observations. ``cov`` is for corners with a noise of 1 px in each frame.

    ``C`` (n, 4, 4) is T_camera_target, ``cov`` (n, 6, 6) belongs to a perturbation on its left, that is in
    the camera frame; ``sse`` (n,) is the weighted sum of squared residuals in px^2, ``corners`` (n,) their
    number.
    """

    C: Array
    cov: Array
    sse: Array
    corners: Array

    def take(self, rows: Indices) -> "Poses":
        """Those of some rows, in that order."""
        return Poses(self.C[rows], self.cov[rows], self.sse[rows], self.corners[rows])


@dataclass(frozen=True)
class _Stack:
    """Views padded to one length: points (n, m, 3), ideal coordinates (n, m, 2), whitening (n, m, 2, 2)."""

    points: Array
    ideal: Array
    whiten: Array


def _stack(views: Sequence[View], camera: Intrinsics) -> _Stack:
    n, m = len(views), max(len(v.points) for v in views)
    points = np.zeros((n, m, 3))
    points[..., 2] = 1.0
    ideal, whiten = np.zeros((n, m, 2)), np.zeros((n, m, 2, 2))
    sizes = np.array([len(v.points) for v in views])
    inside = np.arange(m) < sizes[:, None]
    pixels = np.concatenate([v.corners for v in views])
    points[inside] = np.concatenate([v.points for v in views])
    flat = undistort(pixels, camera)
    ideal[inside] = flat
    weight = np.sqrt(np.concatenate([v.count for v in views]))
    whiten[inside] = weight[:, None, None] * distortion_jacobian(flat, camera)
    return _Stack(points, ideal, whiten)


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


def _residuals(stack: _Stack, C: Array) -> tuple[Array, Array]:
    """Whitened residuals (n, 2m), measured minus predicted, and camera coordinates (n, m, 3)."""
    p = stack.points @ np.swapaxes(C[:, :3, :3], 1, 2) + C[:, None, :3, 3]
    flat = p[..., :2] / p[..., 2:]
    r = (stack.whiten @ (stack.ideal - flat)[..., None])[..., 0]
    return r.reshape(len(C), -1), p


def _jacobian(stack: _Stack, p: Array) -> Array:
    """d predicted / d xi for a perturbation on the left of C, whitened, (n, 2m, 6)."""
    n, m = p.shape[:2]
    x, y, iz = p[..., 0] / p[..., 2], p[..., 1] / p[..., 2], 1.0 / p[..., 2]
    d = np.zeros((n, m, 2, 6))
    d[..., 0, 0], d[..., 0, 2] = iz, -x * iz
    d[..., 1, 1], d[..., 1, 2] = iz, -y * iz
    d[..., 0, 3], d[..., 0, 4], d[..., 0, 5] = -x * y, 1.0 + x * x, -y
    d[..., 1, 3], d[..., 1, 4], d[..., 1, 5] = -1.0 - y * y, x * y, x
    return (stack.whiten @ d).reshape(n, 2 * m, 6)


def refine(
    views: Sequence[View], C: Array, camera: Intrinsics, iterations: int = 12, tolerance: float = 1e-3
) -> Poses:
    """Gauss-Newton from ``C`` (n, 4, 4) until no pose moves by ``tolerance`` of its standard deviation."""
    stack = _stack(views, camera)
    r, p = _residuals(stack, C)
    for _ in range(iterations):
        J = _jacobian(stack, p)
        Jt = np.swapaxes(J, 1, 2)
        N = Jt @ J
        ridge = 1e-12 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        g = Jt @ r[..., None]
        step = np.linalg.solve(N + ridge, g)[..., 0]
        gain = np.sum(step * g[..., 0], axis=1)
        C = se3.exp(step) @ C
        r, p = _residuals(stack, C)
        if np.all(gain < tolerance**2 * np.sum(r * r, axis=1) / r.shape[1] + 1e-18):
            break
    J = _jacobian(stack, p)
    N = np.swapaxes(J, 1, 2) @ J
    cov = np.linalg.inv(N + 1e-12 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(6))
    return Poses(C, cov, np.sum(r * r, axis=1), np.array([len(v.points) for v in views]))


def start_poses(view: View, camera: Intrinsics) -> list[Array]:
    """First guesses of T_camera_target, (4, 4), best first: two for a planar target, else one."""
    if view.start is not None:
        return [view.start]
    ideal = undistort(view.corners, camera)
    spread = view.points - view.points.mean(axis=0)
    _, extent, axes = np.linalg.svd(spread, full_matrices=False)
    planar = extent[2] < 1e-6 * extent[0]
    frame = np.eye(4)  # IPPE wants the plane z = 0 through the origin
    if planar:
        R = axes * np.sign(np.linalg.det(axes))
        frame[:3, :3], frame[:3, 3] = R, -R @ view.points.mean(axis=0)
    points = view.points @ frame[:3, :3].T + frame[:3, 3]
    if planar:
        points[:, 2] = 0.0
    method = cv2.SOLVEPNP_IPPE if planar else cv2.SOLVEPNP_SQPNP
    count, rvecs, tvecs, _ = cv2.solvePnPGeneric(points, ideal, np.eye(3), None, flags=method)
    guesses = []
    for rvec, tvec in list(zip(rvecs, tvecs, strict=True))[:count]:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = cv2.Rodrigues(rvec)[0], tvec.ravel()
        if np.all(np.isfinite(T)) and T[2, 3] > 0.0:
            guesses.append(T @ frame)
    return guesses


def solve_pnp(views: Sequence[View], camera: Intrinsics) -> tuple[Poses, Indices]:
    """Every pose that explains a view, and the view (k,) that each belongs to, best one of each first.

    A planar target seen with little perspective has a second pose, mirrored in its line of sight, that fits
    nearly as well: it is kept, and the robot's motion decides. Every view needs ``MIN_CORNERS`` corners
    that do not lie on a line.
    """
    guesses = [start_poses(v, camera) for v in views]
    owner = np.repeat(np.arange(len(views)), [len(g) for g in guesses])
    poses = refine([views[int(i)] for i in owner], np.array([c for g in guesses for c in g]), camera)
    if len(owner) == len(views):
        return poses, owner
    order = np.lexsort((poses.sse, owner))
    first = np.r_[True, np.diff(owner[order]) > 0]
    best = order[first]
    keep = first | (poses.sse[order] < _AMBIGUOUS * poses.sse[best][owner[order]])
    same = np.linalg.norm(poses.C[order] - poses.C[best][owner[order]], axis=(1, 2)) < 1e-6
    order = order[keep & (first | ~same)]
    return poses.take(order), owner[order]
