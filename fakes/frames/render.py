"""True images: colour and aligned depth of a printed target, for a pinhole camera with lens distortion.

Pixel centres are at integer coordinates, in the image, in the texture and on the supersampled canvas:
canvas index = ``ss x + (ss - 1)/2``. The plate is warped by its homography onto an ideal (undistorted)
canvas and from there through a constant map onto the distorted one, each time only where the plate is;
averaging ``ss x ss`` pixels gives the image. On a bowed plate each ray is followed to where it meets the
print instead of a homography. Forgetting one of the half pixels biases corners by 0.25 px.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from cell.devices import Intrinsics
from cell.poses import Array
from fakes.cubic_spline import weights
from fakes.frames.boxes import Box, BoxPainter
from fakes.frames.plates import Image, Plate
from fakes.frames.stereo import stereo_depth
from fakes.world.camera.truth import StereoTruth

Depth = NDArray[np.uint16]

_SS = 2  # supersampling; 4 costs twice as much for 5 % less corner noise
_NEAREST_M = 0.03  # a plate that comes nearer, or passes behind the camera, is not drawn
_PAD = 4  # px around the plate's rim, for interpolation and blur
_PAPER, _INK = 1.75, 0.22  # brightness of white and black relative to the background's mean
_NOISE_FRAMES = 4
_STEP = 8  # px between the points at which the lens is inverted
_BOW_STEP = 4  # canvas px between the rays that are followed to a bowed plate; 0.001 px beside all of them


@dataclass(frozen=True)
class Optics:
    """Everything about the camera beside its pose. Grey levels are of 255."""

    intrinsics: Intrinsics
    grey: float = 120.0  # mean of the background at normal exposure
    noise_grey: float = 2.0
    blur_px: float = 0.7
    background_m: float = 1.5
    vignette: float = 0.0  # share of light lost in the corners
    depth_noise_mm: float = 1.0
    stereo: StereoTruth | None = None  # instead of white noise
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Band:
    """A belt through the whole picture: ``T_camera_belt`` has its x along the belt and its z out of it."""

    T_camera_belt: RigidTransform
    half_width_m: float = 0.2
    grey: float = 55.0


@dataclass(frozen=True)
class Picture:
    """``colour`` (h, w, 3) BGR and ``depth`` (h, w) in mm, 0 = invalid, aligned to it."""

    colour: Image
    depth: Depth


class Renderer:
    """Draws one plate as one camera sees it, and boxes on a belt; holds buffers, so one instance per
    thread."""

    def __init__(self, optics: Optics, plate: Plate, band: Band | None = None) -> None:
        self.optics, self.plate = optics, plate
        camera = optics.intrinsics
        self._size = (camera.width, camera.height)
        self._rng = np.random.default_rng(optics.seed)
        self._K, self._dist = camera.matrix, np.asarray(camera.dist, dtype=float)
        self._rays = _ray_grid(self._size, self._K, self._dist, ss=1)
        self._lens = _Lens(self._size, self._K, self._dist) if self._dist.any() else None
        self._boxes = BoxPainter(self._K, self._dist, self._rays)
        self._background = _background(self._size, optics.grey, self._rng)
        self._far = np.full(self._background.shape, 1000.0 * optics.background_m, np.float32)
        if band is not None:
            self._lay(band)
        self._light = light_share(self._size, optics.vignette) if optics.vignette else None
        self._noise = [
            self._rng.normal(0.0, optics.noise_grey, (camera.height, camera.width, 3))
            .round()
            .astype(np.int16)
            for _ in range(_NOISE_FRAMES)
        ]
        self._depth_noise = [
            self._rng.normal(0.0, optics.depth_noise_mm, (camera.height, camera.width)).astype(np.float32)
            for _ in range(_NOISE_FRAMES)
        ]

    def render(
        self,
        poses: Sequence[RigidTransform | None],
        gain: float = 1.0,
        boxes: Sequence[Sequence[Box]] = (),
    ) -> Picture:
        """The picture for ``T_camera_target`` at equal steps through the exposure (one for a camera at rest).

        ``gain`` is the exposure relative to normal. ``None``, a plate seen from behind, and one partly
        behind the camera leave the background. ``boxes`` are the same boxes at each of these steps. Depth is
        taken at the middle pose.
        """
        grey = self._background.copy()
        looks = [view for pose in poses if pose is not None and (view := self._look(pose)) is not None]
        if looks:
            self._paint(grey, looks)
        depth = self._depth(looks[len(looks) // 2] if looks else None)
        colour: Image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        self._boxes.paint(colour, depth, boxes)
        return Picture(self._expose(colour, gain), self._measured(depth))

    def _lay(self, band: Band) -> None:
        """Draw the belt into what never changes, with the grain of its fabric."""
        T = band.T_camera_belt
        _, across, normal = T.rotation.as_matrix().T.astype(np.float32)
        slope = self._rays @ normal
        depth = np.float32(normal @ T.translation) / np.where(slope < 0.0, slope, -1.0)
        off = depth * (self._rays @ across) - np.float32(across @ T.translation)
        inside = (slope < 0.0) & (depth > 0.0) & (np.abs(off) < band.half_width_m)
        grain = self._rng.normal(band.grey, 2.0, self._background.shape)
        self._background[inside] = np.clip(grain, 0, 255).astype(np.uint8)[inside]
        self._far[inside] = 1000.0 * depth[inside]

    def _look(self, T_camera_target: RigidTransform) -> "_View | None":
        """Where the plate is in the image, or None when its front is not wholly before the camera."""
        rim = np.ascontiguousarray(T_camera_target.apply(self.plate.outline()))
        inward = T_camera_target.rotation.apply(np.cross(self.plate.right, self.plate.down))
        if rim[:, 2].min() < _NEAREST_M or inward @ rim[0] <= 0.0:
            return None
        if np.abs(rim[:, :2] / rim[:, 2:]).max() > 3.0:
            return None  # far outside, where the distortion polynomial folds back
        pixels = cv2.projectPoints(rim, np.zeros(3), np.zeros(3), self._K, self._dist)[0].reshape(-1, 2)
        ideal = (rim[:, :2] / rim[:, 2:]) @ np.diag([self._K[0, 0], self._K[1, 1]]) + self._K[:2, 2]
        box = _clip(pixels, (0, 0, *self._size))
        ideal_box = _clip(ideal, self._lens.bounds) if self._lens else box
        if box is None or ideal_box is None:
            return None
        return _View(T_camera_target, inward, rim[0], pixels, box, ideal_box)

    def _paint(self, grey: Image, looks: Sequence["_View"]) -> None:
        """Draw the plate into ``grey``, the mean over the views of a moving camera."""
        x0 = min(v.box[0] for v in looks)
        y0 = min(v.box[1] for v in looks)
        x1 = max(v.box[2] for v in looks)
        y1 = max(v.box[3] for v in looks)
        region = grey[y0:y1, x0:x1]
        total = np.zeros(region.shape, np.float32)
        for view in looks:
            cv2.accumulate(self._composed(region, view, (x0, y0, x1, y1)), total)
        mean = cv2.convertScaleAbs(total, alpha=1.0 / len(looks))
        if self.optics.blur_px > 0.0:
            mean = cv2.GaussianBlur(mean, (0, 0), self.optics.blur_px)
        region[:] = mean

    def _composed(self, region: Image, view: "_View", box: tuple[int, int, int, int]) -> Image:
        """``region`` of the background with the plate over it."""
        x0, y0, x1, y1 = box
        big = self._warped(view, box)
        small = cv2.resize(big, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        white = min(self.optics.grey * _PAPER, 250.0)
        black = self.optics.grey * _INK
        small = cv2.convertScaleAbs(small, alpha=(white - black) / 255.0, beta=black)
        composed: Image = cv2.copyTo(small, view.mask(box), region.copy())
        return composed

    def _warped(self, view: "_View", box: tuple[int, int, int, int]) -> Image:
        """The texture on the supersampled canvas, cut to ``box`` (image pixels)."""
        level = self._level(view)
        texture = self.plate.levels[level]
        if self.plate.print.bend:
            return self._warped_over_bow(view, level, box)
        pose = view.T_camera_target
        plane = pose.rotation.as_matrix() @ self.plate.texture_to_target(level)
        plane[:, 2] += pose.translation
        to_canvas = _to_canvas(self._K) @ plane
        x0, y0, x1, y1 = box if self._lens is None else view.ideal_box
        shift = np.array([[1.0, 0.0, -_SS * x0], [0.0, 1.0, -_SS * y0], [0.0, 0.0, 1.0]])
        canvas = None if self._lens is None else self._lens.window(view.ideal_box)
        size = (_SS * (x1 - x0), _SS * (y1 - y0))
        drawn = cv2.warpPerspective(
            texture, shift @ to_canvas, size, dst=canvas, borderMode=cv2.BORDER_REPLICATE
        )
        return drawn if self._lens is None else self._lens.bend(box)

    def _warped_over_bow(self, view: "_View", level: int, box: tuple[int, int, int, int]) -> Image:
        """The same of a plate that is not flat."""
        x0, y0, x1, y1 = box if self._lens is None else view.ideal_box
        size = (_SS * (x1 - x0), _SS * (y1 - y0))
        # Nodes as cv2.resize has the centres of the pixels that it makes larger, one more at each side.
        u, v = (_BOW_STEP * (np.arange(-1, n // _BOW_STEP + 2) + 0.5) - 0.5 for n in size)
        pixels = np.stack(np.meshgrid(u + _SS * x0, v + _SS * y0, [1.0]), axis=-1)[:, :, 0]
        met = self._met(view, pixels @ np.linalg.inv(_to_canvas(self._K)).T)
        met[..., 2] = 1.0  # of (x, y, 1): where on the print, so where in the texture
        plane = self.plate.texture_to_target(level)
        to_texture = np.linalg.inv(np.vstack([plane[:2], [0.0, 0.0, 1.0]]))
        nodes = (met @ to_texture[:2].T).astype(np.float32)
        fine = cv2.resize(nodes, None, fx=_BOW_STEP, fy=_BOW_STEP, interpolation=cv2.INTER_LINEAR)
        maps = fine[_BOW_STEP : _BOW_STEP + size[1], _BOW_STEP : _BOW_STEP + size[0]]
        drawn: Image = cv2.remap(
            self.plate.levels[level], maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        if self._lens is None:
            return drawn
        self._lens.window(view.ideal_box)[:] = drawn
        return self._lens.bend(box)

    def _met(self, view: "_View", rays: NDArray[Any]) -> Array:
        """Where ``rays`` (..., 3) of the camera meet the print, in the target's frame."""
        R, origin = view.T_camera_target.rotation.as_matrix(), view.T_camera_target.inv().translation
        turned = rays @ R
        out: Array = origin + self.plate.print.reach(origin, turned)[..., None] * turned
        return out

    def _level(self, view: "_View") -> int:
        """The texture whose pixels are about as large as the canvas's, at the plate's middle."""
        rim = view.T_camera_target.apply(self.plate.outline(1))
        depth = float(rim[:, 2].mean())
        canvas_px_per_m = _SS * float(self._K[0, 0]) / depth
        ratio = 1.0 / (self.plate.m_per_px * canvas_px_per_m)
        return int(np.clip(round(np.log2(max(ratio, 1e-3))), 0, len(self.plate.levels) - 1))

    def _expose(self, colour: Image, gain: float) -> Image:
        noise = self._noise[self._rng.integers(_NOISE_FRAMES)]
        if self._light is not None:
            colour = cv2.multiply(colour, self._light, scale=gain, dtype=cv2.CV_8U)
        elif gain != 1.0:
            colour = cv2.convertScaleAbs(colour, alpha=gain)
        exposed: Image = cv2.add(colour, noise, dtype=cv2.CV_8U)
        return exposed

    def _depth(self, view: "_View | None") -> NDArray[np.float32]:
        """Depth in mm where the plate is, of a flat one ``(n . p)/(n . ray)``; the background elsewhere."""
        depth = self._far.copy()
        if view is not None:
            x0, y0, x1, y1 = view.box
            rays = self._rays[y0:y1, x0:x1]
            if self.plate.print.bend:
                T = view.T_camera_target.inv()
                turned = cv2.transform(rays, T.rotation.as_matrix().astype(np.float32))
                surface = (1000.0 * self.plate.print.reach(T.translation, turned)).astype(np.float32)
            else:
                slope = cv2.transform(rays, view.inward.astype(np.float32)[None, :])
                surface = cv2.divide(1000.0 * float(view.inward @ view.point), slope)
            cv2.copyTo(surface, view.mask(view.box), depth[y0:y1, x0:x1])
        return depth

    def _measured(self, depth: NDArray[np.float32]) -> Depth:
        if self.optics.stereo is not None:
            return stereo_depth(depth, self.optics.stereo, self._rng)
        noisy = cv2.add(depth, self._depth_noise[self._rng.integers(_NOISE_FRAMES)])
        rounded: Depth = cv2.add(cv2.max(noisy, 0.0), 0.5).astype(np.uint16)
        return rounded


@dataclass(frozen=True)
class _View:
    T_camera_target: RigidTransform
    inward: Array  # (3,) plate normal, away from the viewer, in the camera
    point: Array  # (3,) a point of the plate's plane, in the camera
    rim: Array  # (n, 2) pixels
    box: tuple[int, int, int, int]  # x0, y0, x1, y1
    ideal_box: tuple[int, int, int, int]

    def mask(self, box: tuple[int, int, int, int]) -> Image:
        """255 where the plate is, cut to ``box``."""
        x0, y0, x1, y1 = box
        mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
        points = ((self.rim - [x0, y0]) * 16).round().astype(np.int32)
        cv2.fillPoly(mask, [points], 255, shift=4)
        return mask


class _Lens:
    """The constant way from the distorted canvas to the ideal one, which is the larger of the two."""

    def __init__(self, size: tuple[int, int], K: Array, dist: Array) -> None:
        ideal = cv2.transform(_ray_grid(size, K, dist, _SS), _to_canvas(K)[:2])
        across, down = ideal[..., 0], ideal[..., 1]  # over both at once NumPy is ten times slower
        low = np.floor(np.array([across.min(), down.min()]) / _SS).astype(int) - _PAD
        high = np.ceil(np.array([across.max(), down.max()]) / _SS).astype(int) + _PAD
        self.bounds = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))  # image pixels
        ideal -= (_SS * low).astype(np.float32)
        self._maps = cv2.convertMaps(ideal, None, cv2.CV_16SC2)
        self._canvas = np.zeros(_SS * (high - low)[::-1], np.uint8)

    def window(self, box: tuple[int, int, int, int]) -> Image:
        """The part of the ideal canvas under ``box`` (image pixels), to draw into."""
        x0, y0, x1, y1 = (_SS * (k - origin) for k, origin in zip(box, self.bounds[:2] * 2, strict=True))
        return self._canvas[y0:y1, x0:x1]

    def bend(self, box: tuple[int, int, int, int]) -> Image:
        """What the lens makes of the ideal canvas, cut to ``box`` (image pixels)."""
        x0, y0, x1, y1 = (_SS * k for k in box)
        maps = [np.ascontiguousarray(m[y0:y1, x0:x1]) for m in self._maps]
        bent: Image = cv2.remap(
            self._canvas, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return bent


def _clip(pixels: Array, bounds: tuple[int, int, int, int]) -> tuple[int, int, int, int] | None:
    low = np.maximum(np.floor(pixels.min(axis=0)) - _PAD, bounds[:2]).astype(int)
    high = np.minimum(np.ceil(pixels.max(axis=0)) + _PAD + 1, bounds[2:]).astype(int)
    if np.any(high - low < 2 * _PAD):
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _to_canvas(K: Array) -> Array:
    half = (_SS - 1) / 2
    return np.array([[_SS, 0.0, half], [0.0, _SS, half], [0.0, 0.0, 1.0]]) @ K


def pixel_rays(camera: Intrinsics) -> NDArray[np.float32]:
    """Undistorted rays (x/z, y/z, 1) of every pixel, (h, w, 3)."""
    return _ray_grid((camera.width, camera.height), camera.matrix, np.asarray(camera.dist, dtype=float), ss=1)


def _ray_grid(size: tuple[int, int], K: Array, dist: Array, ss: int) -> NDArray[np.float32]:
    """Undistorted rays (x/z, y/z, 1) of every canvas pixel, shape (ss h, ss w, 3).

    Undistorting iterates for each point, so it is done every ``_STEP`` pixels; a cubic spline between them
    is exact to 1e-6 px for a field as smooth as a lens's.
    """
    u, v = (np.arange(-2 * _STEP, n + 3 * _STEP, _STEP, dtype=float) for n in size)
    nodes = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    xy = cv2.undistortPointsIter(nodes, K, dist, None, None, criteria).reshape(len(v), len(u), 2)
    fine = ((np.arange(n * ss) - (ss - 1) / 2) / ss for n in size)
    of_u, of_v = (weights(len(w), at / _STEP + 2.0) for w, at in zip((u, v), fine, strict=True))
    rays = np.ones((len(of_v), len(of_u), 3), np.float32)
    for k in (0, 1):
        rays[..., k] = of_v @ xy[..., k] @ of_u.T
    return rays


def light_share(size: tuple[int, int], vignette: float) -> NDArray[np.float32]:
    """(h, w, 3) the share of light that a lens lets through: less with the square of the distance."""
    u, v = (np.linspace(-1.0, 1.0, n, dtype=np.float32) for n in size)
    share = 1.0 - vignette * (u[None, :] ** 2 + v[:, None] ** 2) / 2.0
    return np.repeat(share[:, :, None], 3, axis=2).astype(np.float32)


def _background(size: tuple[int, int], mean: float, rng: np.random.Generator) -> Image:
    """A cluttered wall: blobs of several sizes, nothing that looks like a target."""
    width, height = size
    wall = np.full((height, width), mean, np.float32)
    for cell_px, amplitude in ((160, 22.0), (40, 12.0), (12, 5.0)):
        coarse = rng.normal(0.0, amplitude, (height // cell_px + 2, width // cell_px + 2)).astype(np.float32)
        wall += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(wall, 0, 255).astype(np.uint8)
