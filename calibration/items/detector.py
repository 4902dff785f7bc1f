"""Items that stand out of a belt: segmented in depth, measured along their rim in colour.

Depth says that something is there and how high it is; its edges are blurred by several pixels on any real
stereo camera. Colour has sharp edges but does not know what is top and what is side. So the upper face comes
from depth, and its rim is moved to the edge that colour shows (:mod:`calibration.items.rim`).

Depth is off by a per cent of the distance on many cameras, and that would be more than the height of many
items. Where the belt is, the calibrated camera pose says better, so heights are counted from the belt as
depth has it: over the whole picture to tell items from it, and beside each item to measure it.

A camera without depth finds what differs from the belt in colour (:mod:`calibration.items.by_colour`), and
the height of all items has to be known.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.items.by_colour import away_from, belt_without_items, face_of, silhouette, stands_out
from calibration.items.face import face_in_colour, filled, height_sigma, mostly, spread, without_holes
from calibration.items.middle import median
from calibration.items.rim import measured_rim
from calibration.items.shape import Outline, outline
from cell.devices import Intrinsics, ItemView
from cell.errors import error
from cell.poses import Array

Image = NDArray[np.uint8]
Depth = NDArray[np.uint16]
Box = tuple[int, int, int, int]  # x0, y0, x1, y1, px

_COARSE = 4  # px between the points that the first look takes
_MARGIN = 20  # px around an item that its rim may need
_WIDEST = 60  # px that a window is made wider, where a hole of depth hid how far the face goes
_RIM, _FEWEST_PX = 9, 50  # px along the rim where a side may pass for the top; px of a face
_LEVEL_M = 0.02  # from where it should be, depth may have the belt
_CLEAR = 33  # px about what stands out, where depth is neither that nor the belt
_RIM_PX = 3  # closer to the edge of the picture an item may be cut
_BAND_M, _BAND_SIGMAS = 0.004, 2.5  # of depth about an upper face, at least; of its own noise there
_SAME_M = 0.015  # about an upper face, where that noise is looked at


@dataclass(frozen=True)
class ItemSpec:
    """What to look for. ``plane`` is the belt in the camera: unit normal towards the camera (3,) and its
    product with any point of the belt (m). ``region`` (k, 3) m, in the camera, bounds the part of the belt
    that is looked at, or None. Heights are above the belt; ``size_m`` bounds an item's longer side.
    ``height_m`` is the known height of all items, to ``height_sigma_m``; needed where there is no depth.
    """

    normal: tuple[float, float, float]
    offset_m: float
    min_height_m: float
    max_height_m: float
    size_m: tuple[float, float]
    region: tuple[tuple[float, float, float], ...] | None = None
    height_m: float | None = None
    height_sigma_m: float = 0.0

    @classmethod
    def from_mapping(cls, raw: Mapping[str, Any]) -> "ItemSpec":
        """From plain values as they cross the pipe to the vision child; ``ARGUMENT_INVALID``."""
        try:
            region, height = raw.get("region"), raw.get("height_m")
            spec = cls(
                tuple(float(v) for v in raw["normal"]),  # type: ignore[arg-type]
                float(raw["offset_m"]),
                float(raw["min_height_m"]),
                float(raw["max_height_m"]),
                (float(raw["size_m"][0]), float(raw["size_m"][1])),
                None if region is None else tuple(tuple(float(v) for v in p) for p in region),  # type: ignore[misc]
                None if height is None else float(height),
                float(raw.get("height_sigma_m") or 0.0),
            )
        except (KeyError, TypeError, ValueError, IndexError) as exc:
            raise error("ARGUMENT_INVALID", f"items: {type(exc).__name__} {exc}") from exc
        if abs(float(np.linalg.norm(spec.normal)) - 1.0) > 1e-6:
            raise error("ARGUMENT_INVALID", "items.normal is no unit vector")
        if not 0.0 < spec.min_height_m < spec.max_height_m or not 0.0 < spec.size_m[0] < spec.size_m[1]:
            raise error("ARGUMENT_INVALID", "items: heights and sizes must be positive and grow")
        if spec.height_m is not None and not spec.min_height_m <= spec.height_m <= spec.max_height_m:
            raise error("ARGUMENT_INVALID", "items.height_m is not between min_height_m and max_height_m")
        return spec


def rays_of(pixels: Array, camera: Intrinsics) -> Array:
    """Directions (n, 3) with z = 1 of ``pixels`` (n, 2), without the lens's distortion."""
    if not len(pixels):
        return np.empty((0, 3))
    dist = np.asarray(camera.dist, dtype=float)
    xy = cv2.undistortPoints(pixels.reshape(-1, 1, 2), camera.matrix, dist).reshape(-1, 2)
    return np.column_stack([xy, np.ones(len(xy))])


@lru_cache(maxsize=4)
def slopes(camera: Intrinsics, normal: tuple[float, float, float]) -> Array:
    """(h, w): by how much each pixel's depth goes along ``normal``.

    Once for a camera and a belt, of which a cell may have some: of the pixels about each item they took a
    tenth of the time of a picture.
    """
    out = np.empty((camera.height, camera.width))
    u = np.arange(camera.width, dtype=float)
    for v, row in enumerate(out):
        row[:] = rays_of(np.stack([u, np.full_like(u, v)], axis=1), camera) @ np.array(normal)
    out.flags.writeable = False
    return out


class ItemDetector:
    """Finds all items that are wholly in the picture."""

    def __init__(self, spec: ItemSpec, camera: Intrinsics) -> None:
        self.spec, self.camera = spec, camera
        self._K, self._dist = camera.matrix, np.asarray(camera.dist, dtype=float)
        self._normal = np.array(spec.normal)
        across, down = (np.arange(0, n, _COARSE, dtype=float) for n in (camera.width, camera.height))
        u, v = np.meshgrid(across, down)
        rays = self.rays(np.stack([u.ravel(), v.ravel()], axis=1))
        self._slope = (rays @ self._normal).reshape(u.shape).astype(np.float32)
        self._inside = self._region_mask(u.shape)

    def rays(self, pixels: Array) -> Array:
        """Directions (n, 3) with z = 1 of ``pixels`` (n, 2), without the lens's distortion."""
        return rays_of(pixels, self.camera)

    def find(self, colour: Image, depth: Depth | None) -> tuple[ItemView, ...]:
        """Items in ``colour`` (h, w, 3) BGR with ``depth`` (h, w) in mm aligned to it, 0 = invalid.

        Without depth by colour alone, at the known height; ``CAMERA_FAULT`` where none is known.
        """
        if depth is None:
            return self._find_by_colour(colour)
        slope = slopes(self.camera, self.spec.normal)
        level = self._level(depth)
        found = (self._measure(box, colour, depth, slope, level) for box in self._candidates(depth, level))
        return tuple(item for item in found if item is not None)

    def _level(self, depth: Depth) -> float:
        """How high depth has the belt over where it is, m; 0 where it is not to be seen."""
        coarse = depth[::_COARSE, ::_COARSE]
        height = self._heights(coarse, self._slope)[(coarse > 0) & self._inside]
        near = height[np.abs(height) < _LEVEL_M]
        return float(median(near)) if len(near) > _FEWEST_PX else 0.0

    def _candidates(self, depth: Depth, level: float) -> Iterator[Box]:
        """Boxes x0, y0, x1, y1 (px) around what stands out."""
        coarse = without_holes(depth[::_COARSE, ::_COARSE])
        height = self._heights(coarse, self._slope) - level
        low, high = 0.5 * self.spec.min_height_m, self.spec.max_height_m + _BAND_M
        mask = ((height > low) & (height < high) & (coarse > 0) & self._inside).astype(np.uint8)
        return self._boxes(mask)

    def _boxes(self, mask: NDArray[np.uint8]) -> Iterator[Box]:
        """Boxes x0, y0, x1, y1 (px) around what is connected in a coarse ``mask``."""
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        count, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        for x, y, w, h, _ in stats[1:count]:
            x0, y0 = _COARSE * int(x) - _MARGIN, _COARSE * int(y) - _MARGIN
            x1, y1 = _COARSE * int(x + w) + _MARGIN, _COARSE * int(y + h) + _MARGIN
            yield max(x0, 0), max(y0, 0), min(x1, self.camera.width), min(y1, self.camera.height)

    def _measure(
        self, box: Box, colour: Image, depth: Depth, slope: Array, level: float, around: Box | None = None
    ) -> ItemView | None:
        """What stands out in ``box``, in a window ``around`` it where its face reaches farther than that."""
        x0, y0, x1, y1 = around or box
        window = depth[y0:y1, x0:x1]
        height = self._heights(window, slope[y0:y1, x0:x1]) - level
        valid = (window > 0) & (height > 0.5 * self.spec.min_height_m)
        if valid.sum() < _FEWEST_PX:
            return None
        top = float(np.percentile(height[valid], 70.0))
        band = max(_BAND_M, _BAND_SIGMAS * spread(height[valid & (np.abs(height - top) < _SAME_M)]))
        picture = colour[y0:y1, x0:x1]
        level_with, lower = valid & (np.abs(height - top) < band), (window > 0) & (height < top - band)
        unknown, own = window == 0, np.zeros_like(level_with)
        here = np.s_[box[1] - y0 : box[3] - y0, box[0] - x0 : box[2] - x0]
        own[here] = level_with[here]
        face = face_in_colour(picture, filled(own, unknown), valid, level_with, lower, unknown)
        if face is None:
            return None
        if (wider := self._wider(x0, y0, face)) != (x0, y0, x1, y1):
            most = max(abs(a - b) for a, b in zip(box, wider, strict=True))
            return self._measure(box, colour, depth, slope, level, wider) if most <= _WIDEST else None
        inner = cv2.erode(face.astype(np.uint8), np.ones((_RIM, _RIM), np.uint8)).astype(bool)
        inner &= window > 0
        if inner.sum() < _FEWEST_PX:
            return None
        inner &= np.abs(height - float(median(height[inner]))) < band
        top = float(np.mean(height[inner])) - self._beside(height, window > 0, mostly(valid) | face)
        if not self.spec.min_height_m <= top <= self.spec.max_height_m:
            return None
        return self._seen(picture, np.array([x0, y0]), face, top, height_sigma(height, inner, top))

    def _wider(self, x0: int, y0: int, face: NDArray[np.bool_]) -> Box:
        """The window of ``face`` (h, w) at ``x0``, ``y0`` px, with more at the sides where the face goes on
        and the picture does."""
        left, up, right, down = (bool(edge.any()) for edge in (face[:, 0], face[0], face[:, -1], face[-1]))
        return (
            max(x0 - _MARGIN * left, 0),
            max(y0 - _MARGIN * up, 0),
            min(x0 + face.shape[1] + _MARGIN * right, self.camera.width),
            min(y0 + face.shape[0] + _MARGIN * down, self.camera.height),
        )

    def _find_by_colour(self, colour: Image) -> tuple[ItemView, ...]:
        spec = self.spec
        if spec.height_m is None:
            raise error(
                "CAMERA_FAULT",
                "items are looked for by depth, and this camera has none; give items.height_m, the known "
                "height of all items, and they are looked for by colour",
            )
        coarse = np.ascontiguousarray(colour[::_COARSE, ::_COARSE])
        px_per_m = float(self._K[0, 0]) * float(self._slope.max()) / spec.offset_m
        belt = belt_without_items(coarse, spec.size_m[1] * px_per_m / _COARSE)
        mask = stands_out(away_from(coarse, belt)) * self._inside.astype(np.uint8)
        found = (self._by_colour(box, colour, belt, spec.height_m) for box in self._boxes(mask))
        return tuple(item for item in found if item is not None)

    def _by_colour(self, box: Box, colour: Image, belt: Image, height_m: float) -> ItemView | None:
        x0, y0, x1, y1 = box
        picture, corner = colour[y0:y1, x0:x1], np.array([x0, y0])
        beside = belt[y0 // _COARSE : -(-y1 // _COARSE), x0 // _COARSE : -(-x1 // _COARSE)]
        whole = silhouette(away_from(picture, cv2.resize(beside, (x1 - x0, y1 - y0))), _MARGIN)
        if whole is None:
            return None
        face = face_of(whole, partial(self._foot, corner, height_m))
        if face.sum() < _FEWEST_PX:
            return None
        return self._seen(picture, corner, face, height_m, self.spec.height_sigma_m)

    def _seen(
        self, picture: Image, corner: Array, face: NDArray[np.bool_], top: float, sigma_m: float
    ) -> ItemView | None:
        """The item whose upper ``face`` is in a window at ``corner`` px, ``top`` (m) over the belt, to
        ``sigma_m``."""
        rim = measured_rim(picture, face, partial(self._foot, corner, top))
        if rim is None:
            return None
        pixels = rim.points + corner
        edge = np.array([self.camera.width, self.camera.height]) - 1.0 - _RIM_PX
        if np.any(pixels < _RIM_PX) or np.any(pixels > edge):
            return None
        shape = outline(self._on_face(pixels, top), self._normal)
        return self._view(shape, top, rim.sigma_px, sigma_m)

    def _beside(self, height: Array, seen: NDArray[np.bool_], stands: NDArray[np.bool_]) -> float:
        """The height (m) that depth gives to the belt around what ``stands`` out; 0 where it shows none."""
        clear = ~cv2.dilate(stands.astype(np.uint8), np.ones((_CLEAR, _CLEAR), np.uint8)).astype(bool)
        belt = height[seen & clear & (np.abs(height) < _LEVEL_M)]
        if len(belt) <= _FEWEST_PX:
            return 0.0
        middle = float(median(belt))
        near = np.abs(belt - middle) < max(0.5 * self.spec.min_height_m, _BAND_SIGMAS * spread(belt))
        return float(np.mean(belt[near]))

    def _view(self, shape: Outline, height: float, sigma_px: float, height_m: float) -> ItemView | None:
        """A height that is off by ``height_m`` shifts what is seen at a slant along the belt."""
        low, high = self.spec.size_m
        if not low <= shape.length <= high:
            return None
        metres_per_px = float(shape.centre[2]) / float(self._K[0, 0])
        upright = abs(float(shape.centre @ self._normal)) / float(np.linalg.norm(shape.centre))
        slant = float(np.sqrt(1.0 - upright**2)) / upright
        return ItemView(
            point=shape.centre,
            axis=shape.axis,
            size_m=(shape.length, shape.width),
            height_m=height,
            sigma_m=float(np.hypot(sigma_px * metres_per_px, slant * height_m)),
        )

    def _on_face(self, pixels: Array, height: float) -> Array:
        """Points (n, 3) m: the sights through ``pixels`` (n, 2) meet the plane ``height`` over the belt."""
        rays = self.rays(pixels)
        out: Array = rays * ((self.spec.offset_m + height) / (rays @ self._normal))[:, None]
        return out

    def _foot(self, corner: Array, height: float, points: Array) -> Array:
        """Where the foot of an item is below ``points`` (n, 2) px of its upper rim, both in a window."""
        foot = self._on_face(points + corner, height) - height * self._normal
        pixels = cv2.projectPoints(foot, np.zeros(3), np.zeros(3), self._K, self._dist)[0].reshape(-1, 2)
        out: Array = pixels - corner
        return out

    def _heights(self, depth: Depth, slope: Array) -> Array:
        out: Array = depth * 0.001 * slope - self.spec.offset_m
        return out

    def _region_mask(self, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        if self.spec.region is None:
            return np.ones(shape, dtype=bool)
        points = np.array(self.spec.region)
        if np.any(points[:, 2] <= 0.0):
            raise error("ARGUMENT_INVALID", "items.region is partly behind the camera")
        pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), self._K, self._dist)[0].reshape(-1, 2)
        mask = np.zeros(shape, np.uint8)
        cv2.fillPoly(mask, [np.round(pixels / _COARSE).astype(np.int32)], 1)
        return mask.astype(bool)
