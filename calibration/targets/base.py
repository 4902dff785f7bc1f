"""What a calibration target offers: its points, and how they are found in an image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

Image = NDArray[np.uint8]
Ids = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Detection:
    """Corners found in one image: ``corners[i]`` (pixels) is the image of target point ``ids[i]``."""

    ids: Ids  # (n,)
    corners: Array  # (n, 2) u, v; pixel centres at integer coordinates


class Target(Protocol):
    """A calibration target. ``points`` are (n, 3) metres in the target frame.

    ``symmetries`` are the renumberings of the points (each (n,), the identity first) that a detection
    cannot tell apart; a solver that sees several poses can.
    """

    points: Array
    symmetries: Sequence[Ids]

    def detect(self, image: Image) -> Detection | None:
        """Find the target in a grey (h, w) or BGR (h, w, 3) image; None when it is not seen."""
        ...


def grid_points(columns: int, rows: int, pitch: float, first: int = 0) -> Array:
    """Points (columns * rows, 3) row by row; ``first`` is the index of the first one in both directions."""
    y, x = np.mgrid[first : first + rows, first : first + columns].astype(float)
    return np.stack([x.ravel() * pitch, y.ravel() * pitch, np.zeros(columns * rows)], axis=1)


def grid_symmetries(columns: int, rows: int) -> list[Ids]:
    """Renumberings of a grid that turn it onto itself in its plane: 2, or 4 when it is square."""
    ids = np.arange(columns * rows, dtype=np.int64).reshape(rows, columns)
    turns = (0, 1, 2, 3) if columns == rows else (0, 2)
    return [np.ascontiguousarray(np.rot90(ids, k)).ravel() for k in turns]


def as_grey(image: Image) -> Image:
    """``image`` as one contiguous 8-bit channel."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.ascontiguousarray(image, dtype=np.uint8)


def refine_corners(grey: Image, corners: Array, gap_px: Array) -> Array:
    """Corners (n, 2) refined to the saddle or corner within a window that no foreign edge enters.

    ``gap_px`` (n,) is the distance from each corner to the nearest edge that is not its own. The half
    window is ``clip(floor(gap - 1), 2, 7)``: a fixed one reaches into the next edge of a distant target
    and shifts all corners the same way, which shows as an error of range.
    """
    half = np.clip(np.floor(gap_px - 1.0), 2, 7).astype(int)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    refined = corners.astype(np.float32).reshape(-1, 1, 2)
    for size in np.unique(half):
        rows = half == size
        part = np.ascontiguousarray(refined[rows])
        refined[rows] = cv2.cornerSubPix(grey, part, (int(size), int(size)), (-1, -1), criteria)
    moved = np.linalg.norm(refined.reshape(-1, 2) - corners, axis=1)
    result = refined.reshape(-1, 2).astype(float)
    astray = moved > half + 1.0  # drawn to something else: keep what was found first
    result[astray] = corners[astray]
    return result


def grid_spacing_px(corners: Array, columns: int, rows: int) -> Array:
    """Distance (n,) in pixels from each corner of a full grid to its nearest neighbour in the grid."""
    grid = corners.reshape(rows, columns, 2)
    spacing = np.full((rows, columns), np.inf)
    for axis in (0, 1):
        if grid.shape[axis] < 2:
            continue
        step = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        head, tail = [slice(None), slice(None)], [slice(None), slice(None)]
        head[axis], tail[axis] = slice(None, -1), slice(1, None)
        spacing[tuple(head)] = np.minimum(spacing[tuple(head)], step)
        spacing[tuple(tail)] = np.minimum(spacing[tuple(tail)], step)
    return spacing.ravel()
