"""First guesses of a target's pose, for all images at once.

A plane's pose comes from its homography (direct linear transform, Hartley and Zisserman 4.1). Mirroring its
normal in the line of sight leads to the other minimum that a small or distant plane has (Schweighofer and
Pinz 2006). Targets that are not planar go through SQPnP (OpenCV).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.hand_eye.view_stack import Indices, ViewStack, view_stack
from calibration.hand_eye.views import CornerSet, blocks
from cell.devices import Intrinsics
from cell.poses import Array

_FLAT = 1e-6  # extent of a plane's points across it, over the one along it
_NO_IMAGE = 1e-14  # mean square of a target's extent in ideal coordinates


@dataclass(frozen=True)
class Planes:
    """The planar views ``rows`` (k,): their points' ``centre`` (k, 3), and a ``frame`` (k, 3, 3) whose third
    column is the plane's normal."""

    rows: Indices
    centre: Array
    frame: Array


def planes(stack: ViewStack) -> Planes:
    """Of the views whose points lie in one plane. Those of a printed target usually have no height at all."""
    centre = stack.points.sum(axis=2) / stack.sizes[:, None]
    frame = np.tile(np.eye(3), (len(stack), 1, 1))
    planar = ~np.any(stack.points[:, 2], axis=1)
    high = np.flatnonzero(~planar)
    spread = (stack.points[high] - centre[high, :, None]) * stack.inside[high, None]
    axes, extent, _ = np.linalg.svd(spread, full_matrices=False)
    planar[high] = extent[:, 2] < _FLAT * extent[:, 0]
    axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]
    frame[high] = axes
    rows = np.flatnonzero(planar)
    return Planes(rows, centre[rows], frame[rows])


def first_guesses(views: Sequence[CornerSet], camera: Intrinsics) -> Array:
    """The guess (n, 4, 4) from which each view's pose is found, NaN where there is none."""
    if not views:
        return np.zeros((0, 4, 4))
    return np.concatenate([_guesses(views[k], camera) for k in blocks(len(views))])


def _guesses(views: Sequence[CornerSet], camera: Intrinsics) -> Array:
    stack = view_stack(views, camera)
    return start_poses(views, stack, planes(stack))


def start_poses(views: Sequence[CornerSet], stack: ViewStack, flat: Planes) -> Array:
    """A guess (n, 4, 4) of T_camera_target for each view, its own start if it has one.

    NaN where no pose before the camera explains the corners.
    """
    guesses = np.full((len(views), 4, 4), np.nan)
    guesses[flat.rows] = _from_planes(stack.take(flat.rows), flat)
    for i in np.setdiff1d(np.arange(len(views)), flat.rows):
        if views[i].start is None:
            guesses[i] = _from_space(views[i].points, stack.ideal[i, :, : stack.sizes[i]].T)
    for i, view in enumerate(views):
        if view.start is not None:
            guesses[i] = view.start
    guesses[~(guesses[:, 2, 3] > 0.0)] = np.nan
    return guesses


def mirrored(flat: Planes, C: Array) -> Array:
    """Poses (k, 4, 4) of the planar views with the normal mirrored in the line of sight; C is (k, 4, 4)."""
    R = C[:, :3, :3]
    middle = R @ flat.centre[..., None] + C[:, :3, 3:]
    sight = (middle / np.linalg.norm(middle, axis=1, keepdims=True))[..., 0]
    return _about_centre(_half_turn(sight) @ R @ _half_turn(flat.frame[:, :, 2]), middle[..., 0], flat)


def _half_turn(axis: Array) -> Array:
    """Rotations (k, 3, 3) by pi about unit vectors (k, 3)."""
    return np.asarray(2.0 * axis[:, :, None] * axis[:, None, :] - np.eye(3))


def _about_centre(R: Array, middle: Array, flat: Planes) -> Array:
    """Poses (k, 4, 4) that put the points' centres where ``middle`` (k, 3) is."""
    out = np.zeros((len(R), 4, 4))
    out[:, :3, :3] = R
    out[:, :3, 3] = middle - (R @ flat.centre[..., None])[..., 0]
    out[:, 3, 3] = 1.0
    return out


def _from_planes(stack: ViewStack, flat: Planes) -> Array:
    """Poses (k, 4, 4) of views that are planar, all of them."""
    plane = np.swapaxes(flat.frame, 1, 2) @ (stack.points - flat.centre[..., None])
    H = _homographies(plane[:, 0], plane[:, 1], stack)
    R, scale = _rotation_and_scale(H[:, :, :2])
    return _about_centre(R @ np.swapaxes(flat.frame, 1, 2), H[:, :, 2] / scale[:, None], flat)


def _rotation_and_scale(M: Array) -> tuple[Array, Array]:
    """Rotations (k, 3, 3) whose first two columns, times ``scale`` (k,), are nearest to M (k, 3, 2).

    By the polar decomposition ``M = Q S``: with ``G = M^T M = S^2`` and s = det S, the inverse of S is
    ``((tr G + s) 1 - G) / (s tr S)`` and ``(tr S)^2 = tr G + 2 s``.
    """
    G = np.swapaxes(M, 1, 2) @ M
    trace = G[:, 0, 0] + G[:, 1, 1]
    s = np.sqrt(_determinant(G))
    Q = M @ ((trace + s)[:, None, None] * np.eye(2) - G) / (s * np.sqrt(trace + 2.0 * s))[:, None, None]
    normal = np.cross(Q[:, :, 0], Q[:, :, 1])
    return np.concatenate([Q, normal[:, :, None]], axis=2), np.sqrt(s)


def _homographies(u: Array, v: Array, stack: ViewStack) -> Array:
    """H (k, 3, 3), its last entry 1, with ``ideal ~ H (u, v, 1)``; u and v (k, m) are about their centre.

    Corner by corner ``h1 p = x h3 p`` and ``h2 p = y h3 p`` for p = (u, v, 1). The normal equations are made
    of sums of p p^T weighted by 1, x, y and x^2 + y^2; h1 and h2 follow from h3 and are eliminated. NaN where
    the corners or their images lie on a line.
    """
    x, y = stack.ideal[:, 0], stack.ideal[:, 1]
    weights = np.stack([stack.inside, x, y, x * x + y * y], axis=1)
    products = np.stack([u * u, u * v, u, v * v, v, np.ones_like(u)], axis=1)
    sums = (weights @ np.swapaxes(products, 1, 2))[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]]
    one, of_x, of_y, of_both = np.moveaxis(sums.reshape(-1, 4, 3, 3), 1, 0)
    square = one[:, 0, 0] + one[:, 1, 1]
    on_a_line = _determinant(one) <= _FLAT**2 * square**2
    one[on_a_line] = np.nan
    inverse = np.linalg.inv(one)
    to_h1, to_h2 = inverse @ of_x, inverse @ of_y
    left = of_both - of_x @ to_h1 - of_y @ to_h2
    h3 = np.ones((len(u), 3, 1))
    h3[:, :2] = -np.linalg.solve(ridged(left[:, :2, :2]), left[:, :2, 2:])
    H = np.concatenate([to_h1 @ h3, to_h2 @ h3, h3], axis=2).swapaxes(1, 2)
    enlarged = _determinant(H[:, :2, :2] - H[:, :2, 2:] * H[:, 2:, :2])  # of an area, at the centre
    H[~(np.abs(enlarged) * square > _NO_IMAGE * stack.sizes)] = np.nan
    return H


def _determinant(M: Array) -> Array:
    """Of the upper left 2 x 2 of matrices (k, j, j), where NumPy's warns of NaN."""
    return np.asarray(M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] * M[:, 1, 0])


def ridged(N: Array) -> Array:
    """Normal matrices (k, j, j) with so little added that a singular one does not stop the others."""
    return np.asarray(N + 1e-12 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(N.shape[1]))


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
