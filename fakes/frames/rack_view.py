"""A rack drawn into colour and depth: its plate, the openings with what is seen inside, and parts in them.

An opening is drawn over a window of its own with more pixels, its inside cut to its rim, so that its edges
are as exact as those of printed targets. A part that stands out of a slot is a box in front of the plate.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array, from_pose6
from fakes.frames.boxes import (
    BLUR_PX,
    PER_EDGE,
    SUPER,
    Box,
    BoxPainter,
    Face,
    fixed_point,
    on_canvas,
    paint_depth,
    window_of,
)
from fakes.frames.plates import Image, marker_cells
from fakes.frames.render import light_share, pixel_rays
from fakes.frames.stereo import stereo_depth
from fakes.world.rack.rack import PLATE_M, Rack
from fakes.world.rack.truth import RackTruth
from fakes.world.world import World

_BACKGROUND, _FAR_MM = 90.0, 2000.0
_WALL_SHADES = (0.75, 1.25, 0.9, 1.1)
_DEPTH_NOISE_MM = 1.0
_NEAREST_M = 0.05
_NOISE_FRAMES = 4
_PAPER, _INK = 225.0, 25.0  # of a marker


@lru_cache(maxsize=1)
def _noise(seed: int, grey: float, width: int, height: int) -> tuple[NDArray[np.float32], list[Array]]:
    """Noise of colour (k, h, w, 3) and of depth (k of (h, w) mm): drawn once for all views of one camera."""
    rng = np.random.default_rng([seed, 0x51])
    colour = rng.normal(0.0, grey, (_NOISE_FRAMES, height, width, 3)).astype(np.float32)
    coarse = rng.normal(0.0, _DEPTH_NOISE_MM, (_NOISE_FRAMES, height // 8, width // 8)).astype(np.float32)
    return colour, [cv2.resize(one, (width, height)) for one in coarse]


class RackView:
    """Pictures of the world's rack by its camera."""

    def __init__(self, world: World, rack: Rack) -> None:
        self._world, self._rack = world, rack
        lens = world.intrinsics
        self._K, self._dist = lens.matrix, np.array(lens.dist, dtype=float)
        self._rays = pixel_rays(lens)
        self._boxes = BoxPainter(self._K, self._dist, self._rays)
        self._camera = camera = world.camera
        height, width = self._rays.shape[:2]
        self._noise, self._depth_noise = _noise(world.config.seed, camera.noise_grey, width, height)
        self._light = light_share((width, height), camera.vignette)

    def picture(self, t: float, tick: int) -> tuple[Image, NDArray[np.uint16]]:
        """Colour (h, w, 3) and depth (h, w) mm of the exposure around ``t``."""
        return self.drawn(self._world.scene(t).T_base_camera, t, tick)

    def drawn(self, T_base_camera: RigidTransform, t: float, tick: int) -> tuple[Image, NDArray[np.uint16]]:
        """The same for a camera that is somewhere else."""
        world, rack = self._world, self._rack
        height, width = self._rays.shape[:2]
        rng = np.random.default_rng([world.config.seed, tick + 1, 0x51])
        colour = np.full((height, width, 3), _BACKGROUND, np.uint8)
        depth = np.full((height, width), _FAR_MM, np.float32)
        T_camera_base = T_base_camera.inv()
        self._plate(colour, depth, T_camera_base)
        for number in range(1, rack.slots + 1):
            self._slot(colour, depth, T_camera_base * rack.T_base_slot(number))
            self._marker(colour, T_camera_base * rack.T_base_slot(number), number)
        boxes = [
            self._protruding(T_camera_base * rack.T_base_slot(number), rack.offset(part, number, t))
            for number in range(1, rack.slots + 1)
            if (part := rack.in_slot(number, t)) is not None
        ]
        self._boxes.paint(colour, depth, [boxes])
        k = int(rng.integers(_NOISE_FRAMES))
        noisy: Image = cv2.add(colour * self._light, self._noise[k], dtype=cv2.CV_8U)
        wrong = depth + np.float32(1e3 * rack.truth.depth_off_m)
        if self._camera.stereo is not None:
            return noisy, stereo_depth(wrong, self._camera.stereo, rng)
        return noisy, np.clip(wrong + self._depth_noise[k], 0, 65535).astype(np.uint16)

    def _plate(self, colour: Image, depth: NDArray[np.float32], T_camera_base: RigidTransform) -> None:
        truth = self._truth
        low = -0.5 * np.array(truth.opening_m) - PLATE_M
        last = np.array([(truth.columns - 1) * truth.column_pitch_m, (truth.rows - 1) * truth.row_pitch_m])
        high = last + 0.5 * np.array(truth.opening_m) + PLATE_M
        T = T_camera_base * self._rack.T_base_rack
        face = self._face(T.apply(_corners(low, high, 0.0)), truth.plate_colour)
        if face is not None:
            cv2.fillPoly(colour, [fixed_point(face.rim)], face.colour, lineType=cv2.LINE_AA, shift=4)
            paint_depth(depth, self._rays, [face])

    def _slot(self, colour: Image, depth: NDArray[np.float32], T_camera_slot: RigidTransform) -> None:
        """An opening and its inside."""
        truth = self._truth
        half = 0.5 * np.array(truth.opening_m)
        wide = half + truth.chamfer_m
        rim = self._face(T_camera_slot.apply(_corners(-wide, wide, 0.0)), (0, 0, 0))
        if rim is None or (window := window_of([rim.rim], colour.shape)) is None:
            return
        inside = self._inside(T_camera_slot, half)
        x0, y0, x1, y1 = window
        region = colour[y0:y1, x0:x1]
        big = cv2.resize(region, None, fx=SUPER, fy=SUPER, interpolation=cv2.INTER_NEAREST)
        within = big.copy()
        for face in inside:
            cv2.fillPoly(within, [on_canvas(face.rim, x0, y0)], face.colour, shift=4)
        mask = _mask(on_canvas(rim.rim, x0, y0), big.shape[:2])
        both = mask[..., None] * within + (1.0 - mask[..., None]) * big
        small = cv2.resize(both, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        region[:] = np.clip(cv2.GaussianBlur(small, (0, 0), BLUR_PX) + 0.5, 0, 255).astype(np.uint8)
        deep = depth[y0:y1, x0:x1].copy()
        moved = [replace(face, rim=face.rim - [x0, y0]) for face in inside]
        paint_depth(deep, self._rays[y0:y1, x0:x1], moved)
        cut = cv2.resize(mask, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA) > 0.5
        depth[y0:y1, x0:x1][cut] = deep[cut]

    def _marker(self, colour: Image, T_camera_slot: RigidTransform, number: int) -> None:
        """The printed marker beside a slot, where there is one; the black square is cut as an opening is."""
        truth = self._truth.marker
        if truth is None:
            return
        T = T_camera_slot * from_pose6(truth.T_slot_marker)
        cells = marker_cells(truth.dictionary, truth.id + number - 1)
        count = len(cells)

        def face(column: float, row: float, wide: float, bright: float) -> Face | None:
            low = truth.size_m * (np.array([column, count - row - wide]) / count - 0.5)
            high = low + truth.size_m * wide / count
            corners = np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])])
            return self._face(T.apply(np.column_stack([corners, np.zeros(4)])), (bright,) * 3)

        paper = face(-1.0, -1.0, count + 2.0, _PAPER)
        ink = face(0.0, 0.0, count, _INK)
        if paper is None or ink is None or (window := window_of([paper.rim], colour.shape)) is None:
            return
        white = [face(c, r, 1.0, _PAPER) for r, c in zip(*np.nonzero(cells), strict=True)]
        x0, y0, x1, y1 = window
        region = colour[y0:y1, x0:x1]
        big = cv2.resize(region, None, fx=SUPER, fy=SUPER, interpolation=cv2.INTER_NEAREST)
        cv2.fillPoly(big, [on_canvas(paper.rim, x0, y0)], paper.colour, shift=4)
        within = np.full_like(big, _INK)
        for cell in white:
            if cell is not None:
                cv2.fillPoly(within, [on_canvas(cell.rim, x0, y0)], cell.colour, shift=4)
        mask = _mask(on_canvas(ink.rim, x0, y0), big.shape[:2])
        both = mask[..., None] * within + (1.0 - mask[..., None]) * big
        small = cv2.resize(both, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        region[:] = np.clip(cv2.GaussianBlur(small, (0, 0), BLUR_PX) + 0.5, 0, 255).astype(np.uint8)

    def _inside(self, T_camera_slot: RigidTransform, half: Array) -> list[Face]:
        """Chamfer, walls and end of a slot as far as they face the camera, the end first."""
        truth = self._truth
        deep = truth.depth_m + 0.01
        wide = half + truth.chamfer_m
        front, back = _corners(-wide, wide, 0.0), _corners(-half, half, deep)
        mouth = _corners(-half, half, truth.chamfer_m)
        shade = np.array(truth.inside_colour)
        faces = [self._face(T_camera_slot.apply(back), 0.8 * shade)]
        for outer, inner, bright in ((mouth, back, 1.0), (front, mouth, 1.6)):
            if bright > 1.0 and truth.chamfer_m == 0.0:
                continue
            for k, light in enumerate(_WALL_SHADES):
                after = (k + 1) % 4
                wall = np.array([outer[k], outer[after], inner[after], inner[k]])
                faces.append(self._face(T_camera_slot.apply(wall), light * bright * shade))
        return [face for face in faces if face is not None]

    def _protruding(self, T_camera_slot: RigidTransform, T_slot_part: RigidTransform) -> Box:
        """What of a part stands out of the plate; its upper face is its back."""
        width, height, length = self._truth.part_m
        out = max(length - float(T_slot_part.translation[2]), 1e-4)
        back = T_slot_part * RigidTransform.from_translation([0.0, 0.0, -length])
        turned = RigidTransform.from_rotation(Rotation.from_rotvec([np.pi, 0.0, 0.0]))
        blue, green, red = self._truth.part_colour
        return Box(T_camera_slot * back * turned, (width, height, out), (blue, green, red))

    @property
    def _truth(self) -> RackTruth:
        return self._rack.truth

    def _face(self, corners: Array, colour: Sequence[float] | Array) -> Face | None:
        """Of ``corners`` (4, 3) in the camera, when it is turned to it; counter-clockwise from outside."""
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
        normal /= np.linalg.norm(normal)
        offset = float(normal @ corners[0])
        if offset >= 0.0 or corners[:, 2].min() < _NEAREST_M:
            return None
        step = (np.roll(corners, -1, axis=0) - corners)[:, None] / PER_EDGE
        rim = (corners[:, None] + np.arange(PER_EDGE)[:, None] * step).reshape(-1, 3)
        pixels = cv2.projectPoints(rim, np.zeros(3), np.zeros(3), self._K, self._dist)[0].reshape(-1, 2)
        blue, green, red = colour
        return Face((normal, offset), pixels, (float(blue), float(green), float(red)))


def _mask(rim: NDArray[np.int32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """1 within ``rim``, fixed-point pixels, and 0 outside; OpenCV fills a polygon's own border too, so that
    border is filled once from either side."""
    height, width = shape
    around = fixed_point(np.array([[-1, -1], [width, -1], [width, height], [-1, height]], dtype=float))
    inner, outer = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    cv2.fillPoly(inner, [rim], 1, shift=4)
    cv2.fillPoly(outer, [around, rim], 1, shift=4)
    return 0.5 * (inner.astype(np.float32) + 1.0 - outer)


def _corners(low: Array, high: Array, z: float) -> Array:
    """(4, 3) of a rectangle across the slot, counter-clockwise for who looks along -z at its front."""
    (x0, y0), (x1, y1) = low, high
    return np.array([[x0, y0, z], [x0, y1, z], [x1, y1, z], [x1, y0, z]])
