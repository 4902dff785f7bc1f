"""What a lens and a printed target differ from their models in, as seen by every image.

A number that is off moves the pose that the image gives, and leaves a pattern in the image that the pose
cannot take up. The pattern is what the image says of the number by itself; the motion is what makes the
number matter for a hand-eye result.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from calibration.hand_eye.views import CornerSet, blocks, distorted
from cell.devices import Intrinsics
from cell.poses import Array

LENS = ("focal", "aspect", "cx", "cy", "k1", "k2", "p1", "p2")
TARGET = ("scale_x", "scale_y", "bow_xx", "bow_xy", "bow_yy")
NUMBERS = len(LENS) + len(TARGET)


@dataclass(frozen=True)
class LensPrior:
    """Standard deviations: focal length and aspect as shares, principal point in px, distortion."""

    focal: float = 3e-3
    aspect: float = 5e-4
    centre_px: float = 5.0
    radial: float = 1e-2
    tangential: float = 1e-3

    def sigma(self) -> Array:
        """(8,) in the order of ``LENS``."""
        c, k, p = self.centre_px, self.radial, self.tangential
        return np.array([self.focal, self.aspect, c, c, k, 2.0 * k, p, p])


def lens_prior(sigma: Mapping[str, Any] | None) -> LensPrior:
    """Of a lens with a data set's ``camera.sigma``; without one that of a camera calibrated by its maker."""
    usual = LensPrior()
    given = {key: value for key, value in (sigma or {}).items() if value is not None}
    if not given:
        return usual
    focal, centre = given.get("f", usual.focal), given.get("c_px", usual.centre_px)
    # Who knows the one better or worse than usual knows the distortion so too.
    share = max(
        focal / usual.focal if "f" in given else 0.0, centre / usual.centre_px if "c_px" in given else 0.0
    )
    return LensPrior(focal, share * usual.aspect, centre, share * usual.radial, share * usual.tangential)


@dataclass(frozen=True)
class TargetPrior:
    """Standard deviations: the print's scale as a share, and its bow in metres at the target's edge.

    Boards from office printers that were measured are off by 0.1 to 0.4 %.
    """

    scale: float = 2e-3
    bow: float = 2e-4

    def sigma(self) -> Array:
        """(5,) in the order of ``TARGET``."""
        return np.array([self.scale] * 2 + [self.bow] * 3)


def target_prior(target: Mapping[str, Any]) -> TargetPrior:
    """Of a target's table with ``scale_sigma`` and ``flatness_m``; without them one sheet from a printer."""
    usual = TargetPrior()
    return TargetPrior(target.get("scale_sigma") or usual.scale, target.get("flatness_m") or usual.bow)


@dataclass(frozen=True)
class ImageTerms:
    """Of n images, over c numbers: ``moves`` (n, 6, c) the pose from the left, ``info`` (c, c) and ``pull``
    (c,) curvature and gradient of half the squared pixel residuals of all images at their best poses."""

    moves: Array
    info: Array
    pull: Array


def image_terms(
    views: Sequence[CornerSet],
    C: Array,
    camera: Intrinsics,
    shape: "TargetShape",
    predicted: Array | None = None,
) -> ImageTerms:
    """At the images' own best poses ``C`` (n, 4, 4), with the derivatives at ``predicted`` (n, 4, 4).

    Derivatives at ``C`` go with the noise of each image. Their products with the residuals then do not add
    up to zero, and over thousands of images that draws what is hardly known: arm, target and camera that are
    larger together. The poses that all images together predict have no such noise.
    """
    moves = np.empty((len(views), 6, NUMBERS))
    info, pull = np.zeros((NUMBERS, NUMBERS)), np.zeros(NUMBERS)
    for k in blocks(len(views)):
        few = _of_few(views[k], C[k], camera, shape, None if predicted is None else predicted[k])
        moves[k] = few.moves
        info += few.info
        pull += few.pull
    return ImageTerms(moves, info, pull)


def _of_few(
    views: Sequence[CornerSet], C: Array, camera: Intrinsics, shape: "TargetShape", predicted: Array | None
) -> ImageTerms:
    """As :func:`image_terms`, with all corners in memory at once: 1 kB of derivatives each."""
    A = _derivatives(views, C, camera, shape, predicted)
    gram = A @ np.swapaxes(A, 1, 2)
    moves = np.asarray(-np.linalg.solve(gram[:, :6, :6], gram[:, :6, 6:-1]), dtype=float)
    info = (gram[:, 6:-1, 6:-1] + gram[:, 6:-1, :6] @ moves).sum(axis=0)
    pull = -gram[:, 6:-1, -1] - (np.swapaxes(moves, 1, 2) @ gram[:, :6, -1:])[..., 0]
    return ImageTerms(moves, 0.5 * (info + info.T), pull.sum(axis=0))


def _derivatives(
    views: Sequence[CornerSet], C: Array, camera: Intrinsics, shape: "TargetShape", predicted: Array | None
) -> Array:
    """(n, 6 + 13 + 1, 2m) for the corners of each view, whitened: derivatives of the predicted pixels by the
    pose from the left and by the numbers, and the residuals. Views with fewer corners than m end in zeros."""
    sizes = np.array([len(v.points) for v in views])
    place = np.arange(sizes.max())
    at = (np.cumsum(sizes) - sizes)[:, None] + np.minimum(place, sizes[:, None] - 1)
    points = np.swapaxes(np.concatenate([v.points for v in views])[at], 1, 2)
    corners = np.concatenate([v.corners for v in views])[at]
    weight = np.sqrt(np.concatenate([v.count for v in views]))[at] * (place < sizes[:, None])
    n, _, m = points.shape

    T = C if predicted is None else predicted
    ideal, iz = _ideal(points, T)
    pixels, by_ideal, by_lens = through_lens(ideal.reshape(2, -1), camera)
    out = np.empty((n, 6 + NUMBERS + 1, 2, m))
    column = out.transpose(1, 2, 0, 3)  # (20, 2, n, m)
    x, y = ideal
    fx, fy = np.swapaxes(by_ideal, 0, 1).reshape(2, 2, n, m)  # the forces of pnp._jacobian
    fz = -(fx * x + fy * y)
    column[0], column[1], column[2] = fx * iz, fy * iz, fz * iz
    column[3], column[4], column[5] = y * fz - fy, fx - x * fz, x * fy - y * fx
    column[6:14] = by_lens.reshape(len(LENS), 2, n, m)
    on_target = np.swapaxes(T[:, :3, :3], 1, 2) @ out[:, :3].reshape(n, 3, 2 * m)
    across, down, ahead = np.swapaxes(on_target, 0, 1).reshape(3, n, 2, m).transpose(0, 2, 1, 3)
    u, v = shape.off(points[:, 0], points[:, 1])
    column[14], column[15] = across * (u * shape.edge), down * (v * shape.edge)
    column[16], column[17], column[18] = ahead * (u * u), ahead * (u * v), ahead * (v * v)
    if predicted is not None:
        pixels, _, _ = through_lens(_ideal(points, C)[0].reshape(2, -1), camera)
    column[19] = np.moveaxis(corners, 2, 0) - pixels.reshape(2, n, m)
    out *= weight[:, None, None]
    return out.reshape(n, 6 + NUMBERS + 1, 2 * m)


def _ideal(points: Array, T: Array) -> tuple[Array, Array]:
    """Ideal coordinates (2, n, m) and inverse depths (n, m) of ``points`` (n, 3, m) of targets at ``T``
    (n, 4, 4)."""
    p = T[:, :3, :3] @ points + T[:, :3, 3:]
    iz = 1.0 / p[:, 2]
    return np.stack([p[:, 0] * iz, p[:, 1] * iz]), iz


@dataclass(frozen=True)
class TargetShape:
    """Where the bow of a target is measured from: ``centre`` (2,) m, and its edge ``edge`` m from there."""

    centre: Array
    edge: float

    def off(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Places on the target from its centre, of its edge."""
        return (x - self.centre[0]) / self.edge, (y - self.centre[1]) / self.edge

    def columns(self, points: Array) -> Array:
        """(m, 3, 5): how far each point (m, 3) of the target moves for a unit of each number."""
        out = np.zeros((len(points), 3, len(TARGET)))
        u, v = self.off(*points[:, :2].T)
        out[:, 0, 0], out[:, 1, 1] = u * self.edge, v * self.edge
        out[:, 2, 2], out[:, 2, 3], out[:, 2, 4] = u * u, u * v, v * v
        return out

    def moved(self, points: Array, numbers: Array) -> Array:
        """The points (m, 3) with ``numbers`` (5,) of ``TARGET``."""
        x, y, xx, xy, yy = numbers.tolist()
        u, v = self.off(*points[:, :2].T)
        by = [u * (x * self.edge), v * (y * self.edge), xx * u * u + xy * u * v + yy * v * v]
        out: Array = points + np.stack(by, axis=1)
        return out


def target_shape(views: Sequence[CornerSet]) -> TargetShape:
    """Of the target that all ``views`` see parts of."""
    points = np.concatenate([v.points for v in views])[:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    return TargetShape(0.5 * (low + high), float(np.linalg.norm(high - low)) / 2.0)


def moved_camera(camera: Intrinsics, numbers: Array) -> Intrinsics:
    """``camera`` with ``numbers`` (8,) of ``LENS`` added."""
    fx, fy, cx, cy = camera.K
    focal, aspect, dx, dy, k1, k2, p1, p2 = map(float, numbers)
    dist = np.zeros(max(len(camera.dist), 5))
    dist[: len(camera.dist)] = camera.dist
    dist[:4] += (k1, k2, p1, p2)
    K = (fx * (1.0 + focal), fy * (1.0 + focal) * (1.0 + aspect), cx + dx, cy + dy)
    return Intrinsics(camera.width, camera.height, K, tuple(map(float, dist)))


def projected(p: Array, camera: Intrinsics) -> tuple[Array, Array, Array]:
    """Pixels (m, 2) of points ``p`` (m, 3) m in the camera, with the derivatives by the points (m, 2, 3) and
    by the numbers of ``LENS`` (m, 2, 8)."""
    iz = 1.0 / p[:, 2]
    ideal = p[:, :2].T * iz
    pixels, by_ideal, by_lens = through_lens(ideal, camera)
    ahead = -np.sum(by_ideal * ideal, axis=1)
    by_point = np.stack([by_ideal[:, 0], by_ideal[:, 1], ahead], axis=1) * iz
    return pixels.T, by_point.transpose(2, 0, 1), by_lens.transpose(2, 1, 0)


def through_lens(ideal: Array, camera: Intrinsics) -> tuple[Array, Array, Array]:
    """Pixels (2, m) of ideal coordinates (2, m), and their derivatives by these (2, 2, m) and by the numbers
    of ``LENS`` (8, 2, m)."""
    if any(camera.dist[8:]):
        return _through_any_lens(ideal, camera)
    fx, fy, cx, cy = camera.K
    at, (xx, xy, yy) = distorted(ideal, camera)
    x, y = ideal
    r2 = x * x + y * y
    by_k1 = r2
    if any(camera.dist[5:]):
        k4, k5, k6 = (*camera.dist[5:], 0.0, 0.0, 0.0)[:3]
        by_k1 = r2 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    by_lens = np.zeros((len(LENS), 2, len(r2)))
    by_lens[0] = at * np.array([[fx], [fy]])
    by_lens[1, 1] = fy * at[1]
    by_lens[2, 0] = by_lens[3, 1] = 1.0
    by_lens[4] = ideal * by_k1
    by_lens[5] = by_lens[4] * r2
    by_lens[6, 0] = by_lens[7, 1] = 2.0 * x * y
    by_lens[6, 1], by_lens[7, 0] = r2 + 2.0 * y * y, r2 + 2.0 * x * x
    by_lens[4:, 0] *= fx
    by_lens[4:, 1] *= fy
    by_ideal = np.stack([np.stack([fx * xx, fx * xy]), np.stack([fy * xy, fy * yy])])
    return by_lens[0] + np.array([[cx], [cy]]), by_ideal, by_lens


def _through_any_lens(ideal: Array, camera: Intrinsics) -> tuple[Array, Array, Array]:
    """The same for every model of OpenCV, in a multiple of the time."""
    fx, fy, _, _ = camera.K
    rays = np.concatenate([ideal, np.ones((1, ideal.shape[1]))]).T
    pixels, J = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.dist))
    J = np.asarray(J, dtype=float).reshape(len(rays), 2, -1).transpose(2, 1, 0)
    by_lens = J[6:14].copy()
    by_lens[0] = J[6] * fx + J[7] * fy
    by_lens[1] = J[7] * fy
    return np.asarray(pixels, dtype=float).reshape(-1, 2).T, np.swapaxes(J[3:5], 0, 1), by_lens
