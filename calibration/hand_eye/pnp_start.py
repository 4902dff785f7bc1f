"""First guesses of a target's pose, for all images at once.

A plane's pose comes from its homography (direct linear transform, Hartley and Zisserman 4.1). Mirroring its
normal in the line of sight leads to the other minimum that a small or distant plane has (Schweighofer and
Pinz 2006). Targets that are not planar go through SQPnP (OpenCV).
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.views import CornerSet
from cell.poses import Array


def start_poses(views: Sequence[CornerSet], ideal: Sequence[Array]) -> Array:
    """A guess (n, 4, 4) of T_camera_target for each view, its own start if it has one.

    ``ideal`` holds the ideal coordinates (m, 2) of each view's corners. NaN where no pose before the camera
    explains the corners.
    """
    guesses = np.full((len(views), 4, 4), np.nan)
    flat = _at_no_height(views)
    planar: dict[int, list[int]] = {}  # views by number of corners
    for i, view in enumerate(views):
        if view.start is not None:
            guesses[i] = view.start
        elif flat[i] or _is_planar(view.points):
            planar.setdefault(len(view.points), []).append(i)
        else:
            guesses[i] = _from_space(view.points, ideal[i])
    for same in planar.values():
        points = np.stack([views[i].points for i in same])
        guesses[same] = _from_planes(points, np.stack([ideal[i] for i in same]))
    guesses[~(guesses[:, 2, 3] > 0.0)] = np.nan
    return guesses


def mirrored(points: Array, sizes: NDArray[np.int64], C: Array) -> tuple[Array, NDArray[np.int64]]:
    """Poses (k, 4, 4) of the planar views (k,) with the normal mirrored in the line of sight.

    ``points`` (n, 3, m) are padded with zeros beyond the views' own numbers ``sizes`` (n,).
    """
    normal = np.tile([0.0, 0.0, 1.0], (len(C), 1))
    planar = ~np.any(points[:, 2], axis=1)
    for i in np.flatnonzero(~planar):
        own = points[i, :, : sizes[i]].T
        planar[i] = _is_planar(own)
        normal[i] = np.linalg.svd(own - own.mean(axis=0))[2][2]
    rows = np.flatnonzero(planar)
    centre = (points[rows].sum(axis=2) / sizes[rows, None])[..., None]
    R = C[rows, :3, :3]
    middle = R @ centre + C[rows, :3, 3:]
    sight = (middle / np.linalg.norm(middle, axis=1, keepdims=True))[..., 0]
    out = np.zeros((len(rows), 4, 4))
    out[:, :3, :3] = _half_turn(sight) @ R @ _half_turn(normal[rows])
    out[:, :3, 3] = (middle - out[:, :3, :3] @ centre)[..., 0]
    out[:, 3, 3] = 1.0
    return out, rows


def _half_turn(axis: Array) -> Array:
    """Rotations (k, 3, 3) by pi about unit vectors (k, 3)."""
    return np.asarray(2.0 * axis[:, :, None] * axis[:, None, :] - np.eye(3))


def _at_no_height(views: Sequence[CornerSet]) -> NDArray[np.bool_]:
    """(n,) whether all points of a view have z = 0, as those of a printed target usually do."""
    if not views:
        return np.zeros(0, dtype=bool)
    sizes = np.array([len(view.points) for view in views])
    off = np.concatenate([view.points[:, 2] for view in views]) != 0.0
    out: NDArray[np.bool_] = ~np.logical_or.reduceat(off, np.cumsum(sizes) - sizes)
    return out


def _is_planar(points: Array) -> bool:
    """Whether all points lie in one plane."""
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[2] < 1e-6 * extent[0])


def _from_planes(points: Array, ideal: Array) -> Array:
    """Poses (k, 4, 4) from planar points (k, m, 3) and ideal coordinates (k, m, 2)."""
    centre = points.mean(axis=1)
    spread = points - centre[:, None]
    _, axes = np.linalg.eigh(np.swapaxes(spread, 1, 2) @ spread)
    frame = axes[:, :, ::-1].copy()  # columns: the plane's two directions, then its normal
    frame[:, :, 2] *= np.sign(np.linalg.det(frame))[:, None]
    plane = (spread @ frame)[..., :2]
    size = np.sqrt(np.mean(plane**2, axis=(1, 2)))
    middle = ideal.mean(axis=1)
    scale = np.sqrt(np.mean((ideal - middle[:, None]) ** 2, axis=(1, 2)))
    H = _homographies(plane / size[:, None, None], (ideal - middle[:, None]) / scale[:, None, None])
    lift = np.zeros((len(H), 3, 3))
    lift[:, 0, 0] = lift[:, 1, 1] = scale
    lift[:, :2, 2], lift[:, 2, 2] = middle, 1.0
    H = lift @ H
    H[:, :, :2] /= size[:, None, None]
    H *= np.sign(H[:, 2, 2])[:, None, None]
    norm = np.sqrt(np.linalg.norm(H[:, :, 0], axis=1) * np.linalg.norm(H[:, :, 1], axis=1))
    H = H / norm[:, None, None]
    t = H[:, :, 2]
    R = np.stack([H[:, :, 0], H[:, :, 1], np.cross(H[:, :, 0], H[:, :, 1])], axis=2)
    R = se3.nearest_rotation(R) @ np.swapaxes(frame, 1, 2)
    out = np.zeros((len(H), 4, 4))
    out[:, :3, :3] = R
    out[:, :3, 3] = t - (R @ centre[..., None])[..., 0]
    out[:, 3, 3] = 1.0
    return out


def _homographies(plane: Array, ideal: Array) -> Array:
    """H (k, 3, 3) with ``ideal ~ H plane`` from (k, m, 2) each, both of unit size about zero."""
    k, m, _ = plane.shape
    p = np.concatenate([plane, np.ones((k, m, 1))], axis=2)
    products = (p[:, :, :, None] * p[:, :, None, :]).reshape(k, m, 9)
    x, y = ideal[..., 0], ideal[..., 1]
    # The equations' normal matrix is made of sums of p p^T, weighted by 1, x, y and x^2 + y^2.
    weights = np.stack([np.ones_like(x), x, y, x * x + y * y], axis=1)
    one, of_x, of_y, of_both = np.moveaxis((weights @ products).reshape(k, 4, 3, 3), 1, 0)
    N = np.zeros((k, 9, 9))
    N[:, :3, :3] = N[:, 3:6, 3:6] = one
    N[:, :3, 6:] = N[:, 6:, :3] = -of_x
    N[:, 3:6, 6:] = N[:, 6:, 3:6] = -of_y
    N[:, 6:, 6:] = of_both
    _, vectors = np.linalg.eigh(N)
    return np.asarray(vectors[:, :, 0].reshape(k, 3, 3))


def _from_space(points: Array, ideal: Array) -> Array:
    T = np.full((4, 4), np.nan)
    try:
        ok, rvec, t = cv2.solvePnP(points, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        return T
    if ok:
        T[3] = 0.0, 0.0, 0.0, 1.0
        T[:3, :3], T[:3, 3] = cv2.Rodrigues(rvec)[0], np.ravel(t)
    return T
