"""Pictures of boxes on a belt under a camera that looks down at a slant."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.items import ItemDetector, ItemSpec
from cell.devices import Intrinsics
from fakes.frames.boxes import Box, BoxPainter
from fakes.frames.render import pixel_rays
from fakes.world.camera.exposure import times_in

CAMERA = Intrinsics(1280, 800, (802.4, 801.7, 644.2, 396.8), (0.021, -0.043, 0.0006, -0.0004, 0.0))
T_BASE_CAMERA = RigidTransform.from_components(
    [0.1, -0.6, 0.80], Rotation.from_euler("xyz", [188, 5, 12], degrees=True)
)
SIZE = (0.06, 0.04, 0.03)
ORANGE = (40.0, 120.0, 230.0)
BELT_GREY = 55
_SHIFTS = 64  # so many ways, down and across, a picture can lie in the noise of its scene


class Scene:
    """Draws boxes given by x, y (m) and yaw (rad) in the base, whose z = 0 is the belt.

    To draw noise takes five times as long as all else. ``noise_once``: each picture has a part of the same.
    """

    def __init__(self, seed: int = 1, noise_once: bool = False) -> None:
        self._rng = np.random.default_rng(seed)
        self._noise = self._drawn(_SHIFTS) if noise_once else None
        K, dist = CAMERA.matrix, np.array(CAMERA.dist)
        self.rays = pixel_rays(CAMERA)
        self._painter = BoxPainter(K, dist, self.rays)
        self._T = T_BASE_CAMERA.inv()
        self.normal = self._T.rotation.apply([0.0, 0.0, 1.0])
        self.offset_m = float(self.normal @ self._T.translation)

    def spec(self, **changes: object) -> ItemSpec:
        return ItemSpec.from_mapping(
            {
                "normal": self.normal.tolist(),
                "offset_m": self.offset_m,
                "min_height_m": 0.01,
                "max_height_m": 0.08,
                "size_m": [0.03, 0.15],
                **changes,
            }
        )

    def detector(self, **changes: object) -> ItemDetector:
        return ItemDetector(self.spec(**changes), CAMERA)

    def picture(
        self,
        boxes: Sequence[tuple[float, float, float]],
        speed_m_s: float = 0.0,
        size: tuple[float, float, float] = SIZE,
        colour: tuple[float, float, float] = ORANGE,
        exposure_s: float = 0.008,
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Colour and depth of an exposure in whose middle the boxes are where they are said to be."""
        picture = np.full((CAMERA.height, CAMERA.width, 3), BELT_GREY, np.uint8)
        slope = self.rays @ self.normal.astype(np.float32)
        depth = (1000.0 * self.offset_m / slope).astype(np.float32)
        looks = [
            [self._box(x + speed_m_s * dt, y, yaw, size, colour) for x, y, yaw in boxes]
            for dt in times_in(0.0, exposure_s, 1e3 * abs(speed_m_s) * exposure_s)  # a pixel is a millimetre
        ]
        self._painter.paint(picture, depth, looks)
        grain, rough = self._noise_of_a_picture()
        noisy, told = np.clip(picture + grain, 0, 255), np.clip(depth + rough + 0.5, 0, 65535)
        return noisy.astype(np.uint8), told.astype(np.uint16)

    def _noise_of_a_picture(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Of grey levels and of millimetres."""
        if self._noise is None:
            return self._drawn()
        down, across = self._rng.integers(_SHIFTS, size=2)
        grain, rough = (n[down : down + CAMERA.height, across : across + CAMERA.width] for n in self._noise)
        return grain, rough

    def _drawn(self, more: int = 0) -> tuple[NDArray[Any], NDArray[Any]]:
        shape = CAMERA.height + more, CAMERA.width + more
        grain, rough = self._rng.normal(0.0, 2.0, (*shape, 3)), self._rng.normal(0.0, 1.0, shape)
        return (grain.astype(np.float32), rough.astype(np.float32)) if more else (grain, rough)

    def _box(self, x: float, y: float, yaw: float, size: tuple[float, float, float], colour: object) -> Box:
        top = RigidTransform.from_components([x, y, size[2]], Rotation.from_euler("z", yaw))
        return Box(self._T * top, size, colour)  # type: ignore[arg-type]
