"""What the camera of the object face finds on the belt, without a picture."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.devices import Intrinsics, ItemView
from cell.poses import Array
from fakes.frames.stereo import SHARED_PX
from fakes.world.belt.items import Items
from fakes.world.camera.truth import CameraTruth

_SIGMA_M, _SIGMA_RAD = 0.00013, 0.009  # no better than the detector on drawn boxes
_SIGMA_STEREO_M = (
    0.0003  # with depth of a stereo pair, beside that of the height; bench.items_stereo shows less
)
_SCALE_SIGMA = 0.02  # of a height by a stereo pair, as the detector states it
_WHOLE_PX, _SMEARED = 4.0, 0.1  # a smear that does no harm; by each pixel more, of the middle along the belt
_RIM_PX = 5.0
_ABOUT = 3.0  # the detector's window about a face, in sizes of that
_LOOK_M = 1.2  # along the belt, each way from below the camera


def items_seen(
    items: Items, T_base_camera: RigidTransform, t: float, spec: Mapping[str, Any], look: "Look"
) -> tuple[ItemView, ...]:
    """Those that lie wholly in the picture and are what ``spec`` (``ItemSpec`` as a table) asks for."""
    T_camera_base, normal = T_base_camera.inv().as_matrix(), np.array(spec["normal"], dtype=float)
    moves, half = T_camera_base[:3, :3] @ items.belt.T_base_belt.as_matrix()[:3, 0], 0.5 * look.exposure_s
    smear_m = abs(items.belt.travel_at(t + half) - items.belt.travel_at(t - half))
    below = float(items.belt.T_base_belt.inv().apply(T_base_camera.translation)[0])
    found = []
    for number in items.numbers(t, below - _LOOK_M, below + _LOOK_M):
        top = T_camera_base @ items.matrix(number, t)
        if look.camera.row_time_s:  # where it is when its row is exposed
            late = float(look.camera.row_delay_s(top[:3, 3]))
            top = T_camera_base @ items.matrix(number, t + late)
        middle, size_m = top[:3, 3], items.lying(number).size_m
        noise = np.random.default_rng([look.seed, look.tick, number, 0x5EE]).standard_normal(6)
        corners = _corners(size_m) @ top[:3, :3].T + middle
        if corners[:, 2].min() < 0.05 or not look.holds(corners):
            continue
        sigma_h = look.height_sigma_m(middle, normal, size_m)
        height = look.height_told(float(normal @ middle) - float(spec["offset_m"]) + sigma_h * noise[5])
        height += look.height_off_m(middle, normal, size_m, float(spec["offset_m"]))
        if not spec["min_height_m"] <= height <= spec["max_height_m"]:
            continue
        if not spec["size_m"][0] <= max(size_m[:2]) <= spec["size_m"][1]:
            continue
        if not _within(middle, spec.get("region"), normal):
            continue
        if not look.camera.depth:
            height = float(spec["height_m"])
        # On the sight, where it is as high as is believed.
        middle = middle * (float(spec["offset_m"]) + height) / float(normal @ middle)
        middle = look.placed(middle, normal)
        sigma = _SIGMA_M if look.camera.stereo is None else _SIGMA_STEREO_M
        off = sigma * noise[:3]
        if look.camera.stereo is not None:
            sigma = float(np.hypot(sigma, _slant(middle, normal) * np.hypot(sigma_h, _SCALE_SIGMA * height)))
        turn = _SIGMA_RAD * noise[3]
        axis = top[:3, :3] @ [np.cos(turn), np.sin(turn), 0.0]
        smeared = _SMEARED * max(smear_m - _WHOLE_PX * middle[2] / look.camera.K[0], 0.0)
        off = off + smeared * noise[4] * moves
        sigma = float(np.hypot(sigma, smeared))
        length, width = sorted(size_m[:2], reverse=True)
        found.append(ItemView(middle + off, axis, (length, width), height, sigma))
    return tuple(found)


class Look:
    """One exposure: ``project`` (n, 3) m to (n, 2) px in a picture of ``camera``, of which the detector
    believes that it has the ``lens``."""

    def __init__(self, project: Any, camera: CameraTruth, lens: Intrinsics, seed: int, tick: int) -> None:
        self._project, self._size = project, np.array([camera.width, camera.height], dtype=float)
        self._lens = None if lens == camera.true_lens() else lens
        self.camera, self.seed, self.tick = camera, seed, tick
        self.exposure_s = camera.exposure().time_s

    def holds(self, points: Array) -> bool:
        """Whether all of ``points`` (n, 3) are in the picture."""
        uv = self._project(np.ascontiguousarray(points))
        return bool(np.all((uv > _RIM_PX) & (uv < self._size - 1.0 - _RIM_PX)))

    def height_told(self, height_m: float) -> float:
        """The height over the belt that depth gives to a face; the belt's is off by the same share."""
        return height_m if self.camera.stereo is None else self.camera.stereo.scale * height_m

    def height_sigma_m(self, middle: Array, normal: Array, size_m: Sequence[float]) -> float:
        """Noise of the height that depth gives to a face of that size, whose ``middle`` (3,) is in the
        camera, m.

        It is the mean of a face above that of the belt beside it, which is about as large in the detector's
        window. Neighbours share their noise, as in :mod:`fakes.frames.stereo`, and parts that do not share it
        average; what rounding to steps does to the whole face is the same in each picture: `height_off_m`.
        """
        if (stereo := self.camera.stereo) is None:
            return 0.0
        depth_m, (fx, fy) = float(middle[2]), self.camera.K[:2]
        parts = max(size_m[0] * size_m[1] * fx * fy / (depth_m * SHARED_PX) ** 2, 1.0)
        common = stereo.common_step_m(depth_m, _depth_spread_m(normal, size_m))
        averages = stereo.depth_sigma_m(depth_m) ** 2 - common**2
        return float(abs(normal @ middle) / depth_m * np.sqrt(2.0 * averages / parts))

    def height_off_m(self, middle: Array, normal: Array, size_m: Sequence[float], offset_m: float) -> float:
        """By how much that height is off at this place of the picture, for all items alike, m: what steps and
        millimetres do to the mean of the face, less what they do to that of the belt about it, which is
        ``offset_m`` from the camera. In pictures it is larger, as the detector leaves out what is far from
        the middle, by steps as well."""
        if (stereo := self.camera.stereo) is None:
            return 0.0
        face_m, upright = float(middle[2]), float(normal @ middle) / float(middle[2])
        spread_m = _depth_spread_m(normal, size_m)
        face = stereo.told_off_m(face_m, spread_m)
        belt = stereo.told_off_m(offset_m / upright, _ABOUT * spread_m)
        return upright * (face - belt)

    def placed(self, point: Array, normal: Array) -> Array:
        """Where the sight through the pixel of ``point`` (3,), by the detector's lens, meets its level."""
        if self._lens is None:
            return point
        uv = self._project(point[None]).reshape(1, 1, 2)
        xy = cv2.undistortPoints(uv, self._lens.matrix, np.array(self._lens.dist, dtype=float)).ravel()
        sight = np.append(xy, 1.0)
        out: Array = sight * float(normal @ point) / float(normal @ sight)
        return out


def _depth_spread_m(normal: Array, size_m: Sequence[float]) -> float:
    """Standard deviation of the depths of a face that lies aslant in the picture, m: it spreads disparities
    about as noise does."""
    return float(np.linalg.norm(normal[:2]) * np.hypot(size_m[0], size_m[1]) / np.sqrt(24.0))


def _slant(point: Array, normal: Array) -> float:
    """The tangent of the angle between the sight to ``point`` (3,) and the belt's ``normal`` (3,)."""
    along = float(point @ normal)
    return float(np.linalg.norm(point - along * normal)) / abs(along)


def _corners(size_m: Sequence[float]) -> Array:
    half = 0.5 * np.array(size_m[:2])
    return np.array([[x * half[0], y * half[1], 0.0] for x in (-1, 1) for y in (-1, 1)])


def _within(point: Array, region: Any, normal: Array) -> bool:
    """Whether ``point`` is over the convex polygon ``region`` (k, 3), both in the camera."""
    if region is None:
        return True
    corners = np.array(region, dtype=float)
    after = np.roll(corners, -1, axis=0)
    side = np.cross(after - corners, point - corners) @ normal
    return bool(np.all(side >= 0.0) or np.all(side <= 0.0))
