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

from calibration.hand_eye import se3
from calibration.hand_eye.views import CornerSet, blocks
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
    gram = np.empty((len(views), 6 + NUMBERS + 1, 6 + NUMBERS + 1))
    sizes = np.array([len(v.points) for v in views])
    rows = _derivatives(views, np.repeat(C if predicted is None else predicted, sizes, axis=0), camera, shape)
    if predicted is not None:
        rows[:, -1] = _residuals(views, np.repeat(C, sizes, axis=0), camera)
    starts = 2 * np.concatenate([[0], np.cumsum(sizes)])
    for size in np.unique(sizes):  # views of one size together
        of = np.flatnonzero(sizes == size)
        A = rows[(starts[of, None] + np.arange(2 * size)).ravel()].reshape(len(of), 2 * size, -1)
        gram[of] = np.swapaxes(A, 1, 2) @ A
    moves = np.asarray(-np.linalg.solve(gram[:, :6, :6], gram[:, :6, 6:-1]), dtype=float)
    info = gram[:, 6:-1, 6:-1] + gram[:, 6:-1, :6] @ moves
    pull = -gram[:, 6:-1, -1] - (np.swapaxes(moves, 1, 2) @ gram[:, :6, -1:])[..., 0]
    whole = info.sum(axis=0)
    return ImageTerms(moves, 0.5 * (whole + whole.T), pull.sum(axis=0))


@dataclass(frozen=True)
class TargetShape:
    """Where the bow of a target is measured from: ``centre`` (2,) m, and its edge ``edge`` m from there."""

    centre: Array
    edge: float

    def columns(self, points: Array) -> Array:
        """(m, 3, 5): how far each point (m, 3) of the target moves for a unit of each number."""
        out = np.zeros((len(points), 3, len(TARGET)))
        off = points[:, :2] - self.centre
        out[:, 0, 0], out[:, 1, 1] = off[:, 0], off[:, 1]
        u, v = (off / self.edge).T
        out[:, 2, 2], out[:, 2, 3], out[:, 2, 4] = u * u, u * v, v * v
        return out

    def moved(self, points: Array, numbers: Array) -> Array:
        """The points (m, 3) with ``numbers`` (5,) of ``TARGET``."""
        out: Array = points + self.columns(points) @ numbers
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
    fx, fy, _, _ = camera.K
    dist = np.zeros(max(len(camera.dist), 5))
    dist[: len(camera.dist)] = camera.dist
    pixels, J = cv2.projectPoints(p, np.zeros(3), np.zeros(3), camera.matrix, dist)
    J = J.reshape(len(p), 2, -1)
    by_lens = J[:, :, 6:14].copy()
    by_lens[:, :, 0] = J[:, :, 6] * fx + J[:, :, 7] * fy
    by_lens[:, :, 1] = J[:, :, 7] * fy
    return pixels.reshape(-1, 2), J[:, :, 3:6], by_lens


def _residuals(views: Sequence[CornerSet], C: Array, camera: Intrinsics) -> Array:
    """(2m,) of all corners, whitened. ``C`` (m, 4, 4) is the pose of each corner's view."""
    points = np.concatenate([v.points for v in views])
    p = (C[:, :3, :3] @ points[..., None])[..., 0] + C[:, :3, 3]
    pixels, _ = cv2.projectPoints(p, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.dist))
    off = np.concatenate([v.corners for v in views]) - pixels.reshape(-1, 2)
    return np.asarray((off * np.sqrt(np.concatenate([v.count for v in views]))[:, None]).ravel())


def _derivatives(views: Sequence[CornerSet], C: Array, camera: Intrinsics, shape: TargetShape) -> Array:
    """(2m, 6 + 13 + 1) for all corners: derivatives of the predicted pixels by the pose from the left and by
    the numbers, and the residuals, whitened. ``C`` (m, 4, 4) is the pose of each corner's view."""
    points = np.concatenate([v.points for v in views])
    corners = np.concatenate([v.corners for v in views])
    p = (C[:, :3, :3] @ points[..., None])[..., 0] + C[:, :3, 3]
    predicted, by_point, by_lens = projected(p, camera)
    out = np.empty((len(p), 2, 6 + NUMBERS + 1))
    out[:, :, :3] = by_point
    out[:, :, 3:6] = -by_point @ se3.hat(p)
    out[:, :, 6:14] = by_lens
    out[:, :, 14:-1] = by_point @ C[:, :3, :3] @ shape.columns(points)
    out[:, :, -1] = corners - predicted
    out *= np.sqrt(np.concatenate([v.count for v in views]))[:, None, None]
    return out.reshape(2 * len(p), -1)
