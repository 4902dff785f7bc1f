"""Boxes on a belt, drawn into colour and depth as a camera sees them.

A box is convex, so it is its visible faces; each is a polygon whose edges are followed through the lens. It
is filled on a canvas with ``SUPER`` times as many pixels, where canvas index = ``SUPER x + (SUPER - 1)/2``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from cell.poses import Array
from fakes.frames.plates import Image

SUPER = 4
_PAD = 3  # px
PER_EDGE = 6
_NEAREST_M = 0.05
_WIDEST = 1.2  # x/z or y/z
_SIDE_SHADE = 0.45  # light comes from above
BLUR_PX = 0.7
# Corners of a box in units of half its size, and its faces, each counter-clockwise from outside.
_CORNERS = np.array([[x, y, z] for z in (-1.0, 0.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
_FACES = np.array([(4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)])
_NEXT = [1, 2, 3, 0]
_TURN, _TURN_BACK = [1, 2, 0], [2, 0, 1]  # of a cross product
_ZERO = np.zeros(3)


@dataclass(frozen=True, eq=False)
class Box:
    """``T_camera_top``: middle of the upper face, x along ``size_m[0]``, z up; sizes m; ``colour`` BGR."""

    T_camera_top: RigidTransform
    size_m: tuple[float, float, float]
    colour: tuple[float, float, float]

    def corners(self) -> Array:
        """(8, 3) m in the camera: four below, four above."""
        out: Array = self.T_camera_top.apply(_CORNERS * self.size_m)
        return out


@dataclass(frozen=True, eq=False)
class Face:
    """A plane polygon as the camera sees it."""

    plane: tuple[Array, float]  # outward normal and its product with the face's points, in the camera
    rim: Array  # (n, 2) px
    colour: tuple[float, ...]


class BoxPainter:
    """Draws boxes for one camera: matrix ``K`` (3, 3), ``dist``, and ``rays`` (h, w, 3) of its pixels."""

    def __init__(self, K: Array, dist: Array, rays: NDArray[np.float32]) -> None:
        self._K, self._dist, self._rays = K, dist, rays

    def paint(self, colour: Image, depth: NDArray[np.float32], looks: Sequence[Sequence[Box]]) -> None:
        """Draw into ``colour`` (h, w, 3) the mean over ``looks``, which are equal steps through the
        exposure with the same boxes in the same order; into ``depth`` (h, w) mm the middle one."""
        if not looks:
            return
        for boxes in zip(*looks, strict=True):
            if any(_out_of_sight(box.corners()) for box in boxes):
                continue
            seen = [self._faces(box) for box in boxes]
            self._paint_colour(colour, seen)
            self._paint_depth(depth, seen[len(seen) // 2])

    def _faces(self, box: Box) -> list[Face]:
        """Those that are turned to the camera, the upper one last."""
        faces = box.corners()[_FACES]  # (5, 4, 3)
        along, down = faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 1]
        normals = along[:, _TURN] * down[:, _TURN_BACK] - along[:, _TURN_BACK] * down[:, _TURN]
        normals /= np.sqrt((normals**2).sum(axis=1))[:, None]
        offsets = (normals * faces[:, 0]).sum(axis=1)
        turned = np.flatnonzero(offsets < 0.0)
        if not len(turned):
            return []
        points = faces[turned]
        step = (points[:, _NEXT] - points)[:, :, None] / PER_EDGE
        rims = points[:, :, None] + np.arange(PER_EDGE)[:, None] * step
        pixels = cv2.projectPoints(rims.reshape(-1, 3), _ZERO, _ZERO, self._K, self._dist)[0]
        shades = [1.0 if k == 0 else _SIDE_SHADE * (1.0 + 0.15 * k) for k in turned]
        return [
            Face((normals[k], float(offsets[k])), rim, tuple(shade * c for c in box.colour))
            for k, rim, shade in zip(turned, pixels.reshape(len(turned), -1, 2), shades, strict=True)
        ][::-1]

    def _paint_colour(self, colour: Image, seen: Sequence[list[Face]]) -> None:
        window = self._window([face.rim for faces in seen for face in faces])
        if window is None:
            return
        x0, y0, x1, y1 = window
        region = colour[y0:y1, x0:x1]
        big = cv2.resize(region, None, fx=SUPER, fy=SUPER, interpolation=cv2.INTER_NEAREST)
        total = np.zeros(region.shape, np.float32)
        for faces in seen:
            canvas = big.copy()
            for face in faces:
                cv2.fillPoly(canvas, [on_canvas(face.rim, x0, y0)], face.colour, shift=4)
            total += cv2.resize(canvas, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        mean = cv2.GaussianBlur(total / len(seen), (0, 0), BLUR_PX)
        region[:] = np.clip(mean + 0.5, 0, 255).astype(np.uint8)

    def _paint_depth(self, depth: NDArray[np.float32], faces: list[Face]) -> None:
        paint_depth(depth, self._rays, faces)

    def _window(self, rims: list[Array]) -> tuple[int, int, int, int] | None:
        return window_of(rims, self._rays.shape)


def paint_depth(depth: NDArray[np.float32], rays: NDArray[np.float32], faces: Sequence[Face]) -> None:
    """Write the depth of ``faces`` into ``depth`` (h, w) mm, each over the one before."""
    window = window_of([face.rim for face in faces], rays.shape)
    if window is None:
        return
    x0, y0, x1, y1 = window
    region, rays = depth[y0:y1, x0:x1], rays[y0:y1, x0:x1]
    for face in faces:
        mask = np.zeros(region.shape, np.uint8)
        cv2.fillPoly(mask, [fixed_point(face.rim - [x0, y0])], 1, shift=4)
        inside = mask.astype(bool)
        normal, offset = face.plane
        region[inside] = 1000.0 * offset / (rays[inside] @ normal.astype(np.float32))


def window_of(rims: Sequence[Array], shape: tuple[int, ...]) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 around ``rims`` (n, 2) px in a picture of ``shape``; None where nothing is left."""
    if not rims:
        return None
    height, width = shape[:2]
    points = np.vstack(rims)
    low = np.maximum(np.floor(points.min(axis=0)).astype(int) - _PAD, 0)
    high = np.minimum(np.ceil(points.max(axis=0)).astype(int) + _PAD + 1, [width, height])
    if np.any(high - low < 2):
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _out_of_sight(corners: Array) -> bool:
    """Behind the camera, or so far beside it that the distortion polynomial folds back."""
    if corners[:, 2].min() < _NEAREST_M:
        return True
    return bool(np.abs(corners[:, :2] / corners[:, 2:]).max() > _WIDEST)


def on_canvas(rim: Array, x0: int, y0: int) -> NDArray[np.int32]:
    """``rim`` (n, 2) px on the larger canvas of a window that begins at pixel (x0, y0)."""
    return fixed_point(SUPER * (rim - [x0, y0]) + (SUPER - 1) / 2)


def fixed_point(points: Array) -> NDArray[np.int32]:
    """Fixed-point coordinates with four binary places, as ``shift=4`` takes them."""
    return np.round(points * 16.0).astype(np.int32)
