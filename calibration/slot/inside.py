"""Whether something is in a slot, by depth: it is off by millimetres, and a slot is deeper than that.

Depth says no more than that here; where a slot is across the sight comes from colour.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from calibration.slot.rectangle import Rectangle, project
from cell.devices import Intrinsics
from cell.poses import Array

_INNER, _RIM = 0.5, (1.15, 1.5)  # of the opening's size: what is taken for its inside, and for its plate
_FEWEST = 30  # px with a depth
_LEAST_SHARE = 0.3  # of the pixels must have a depth


@dataclass(frozen=True)
class Inside:
    """Median depths, m: of the plate around the opening and within it; None where too few pixels have one."""

    plate: float | None
    within: float | None

    @property
    def deeper(self) -> float | None:
        """By how much it is deeper within, m; negative where something stands out."""
        return None if self.plate is None or self.within is None else self.within - self.plate


def depth_inside(
    depth_mm: NDArray[np.uint16], camera: Intrinsics, T_camera: RigidTransform, opening: Rectangle
) -> Inside:
    """Of ``depth_mm`` (h, w), 0 where there is none; ``T_camera`` of the opening."""
    corners = opening.corners()
    inner = _mask(depth_mm.shape, project(camera, T_camera, _INNER * corners))
    low, high = (_mask(depth_mm.shape, project(camera, T_camera, f * corners)) for f in _RIM)
    return Inside(_median(depth_mm, high & ~low), _median(depth_mm, inner))


def _mask(shape: tuple[int, ...], corners: Array) -> NDArray[np.bool_]:
    mask = np.zeros(shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, np.round(corners).astype(np.int32), 1)
    return np.asarray(mask > 0)


def _median(depth_mm: NDArray[np.uint16], mask: NDArray[np.bool_]) -> float | None:
    values = depth_mm[mask]
    known = values[values > 0]
    if len(known) < max(_FEWEST, _LEAST_SHARE * len(values)):
        return None
    return 1e-3 * float(np.median(known))
