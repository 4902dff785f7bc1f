"""What the pictures of a look tell: where the slot is, and whether something is in it. Blocks on the disk."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from calibration.slot.inside import Inside, depth_inside
from calibration.slot.marker import SlotMarker, find_by_marker
from calibration.slot.opening import Expected, FoundOpening, find_opening
from calibration.slot.rectangle import Rectangle
from cell.devices import Intrinsics
from cell.errors import error
from cell.poses import adjoint, from_pose6


@dataclass(frozen=True)
class Look:
    """Pictures of one look. ``T_base_slot`` is as the rack's model or an earlier look has it, known to
    ``sigma`` (6,); poses are (6,). ``looks`` at the slot from the rack's model on, this one included."""

    colour: Sequence[Path]
    depth: Sequence[Path]
    camera: Mapping[str, Any]
    T_base_camera: Sequence[float]
    T_base_slot: Sequence[float]
    sigma: Sequence[float]
    reach_m: float
    looks: int = 1

    @property
    def intrinsics(self) -> Intrinsics:
        c = self.camera
        fx, fy, cx, cy = c["K"]
        return Intrinsics(c["width"], c["height"], (fx, fy, cx, cy), tuple(c["dist"]))

    @property
    def T_camera_slot(self) -> RigidTransform:
        """As it is expected."""
        return from_pose6(self.T_base_camera).inv() * from_pose6(self.T_base_slot)


def inside(look: Look, opening: Rectangle) -> Inside:
    """What depth has of the slot where it is expected."""
    picture = _read(look.depth[0], cv2.IMREAD_UNCHANGED).astype(np.uint16)
    return depth_inside(picture, look.intrinsics, look.T_camera_slot, opening)


def seen_by_marker(look: Look, marker: SlotMarker) -> FoundOpening:
    """The slot by its ``marker`` in the mean of the pictures; ``OPENING_NOT_SEEN``."""
    expected = Expected(look.T_camera_slot, np.diag(np.square(look.sigma)))
    return find_by_marker(_mean(look), look.intrinsics, marker, expected, look.reach_m, look.looks)


def seen(look: Look, rectangle: Rectangle, depth_m: float = 0.0) -> FoundOpening:
    """``rectangle`` that far in the slot, by its edges in the mean of the pictures; ``OPENING_NOT_SEEN``.

    ``T_camera`` of what is found is that of the slot.
    """
    step = RigidTransform.from_translation([0.0, 0.0, depth_m])
    mean = _mean(look)
    expected = Expected(look.T_camera_slot * step, np.diag(np.square(look.sigma)))
    found = find_opening(mean, look.intrinsics, rectangle, expected, look.reach_m)
    back = adjoint(step.as_matrix())
    return replace(found, T_camera=found.T_camera * step.inv(), cov=back @ found.cov @ back.T)


def _mean(look: Look) -> NDArray[np.uint8]:
    pictures = np.array([_read(path, cv2.IMREAD_COLOR) for path in look.colour])
    mean: NDArray[np.uint8] = np.round(pictures.mean(axis=0)).astype(np.uint8)
    return mean


def _read(path: Path, how: int) -> NDArray[Any]:
    picture = cv2.imread(str(path), how)
    if picture is None:
        raise error("FILE_UNREADABLE", f"{path} is no picture")
    return np.asarray(picture)
