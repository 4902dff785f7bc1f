"""Chessboards, also on images that are dark or low in contrast."""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.targets.base import (
    Detection,
    Ids,
    Image,
    as_grey,
    grid_points,
    grid_spacing_px,
    grid_symmetries,
    refine_corners,
)
from cell.poses import Array

_DARK = 60.0  # mean grey below which the histogram is equalised before the first try
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE


class ChessboardTarget:
    """Inner corners row by row, origin at the first, z into the board.

    Which end of the board comes first cannot be told from one image (``symmetries``).
    """

    def __init__(self, columns: int, rows: int, square_m: float) -> None:
        self._size = (columns, rows)
        self.points = grid_points(columns, rows, square_m)
        self.symmetries: Sequence[Ids] = grid_symmetries(columns, rows)

    def detect(self, image: Image) -> Detection | None:
        grey = as_grey(image)
        found = self._find(grey)
        if found is None:
            return None
        columns, rows = self._size
        corners = right_handed(found, columns, rows)
        gap = 0.5 * grid_spacing_px(corners, columns, rows)
        ids = np.arange(columns * rows, dtype=np.int64)
        return Detection(ids, refine_corners(grey, corners, gap))

    def _find(self, grey: Image) -> Array | None:
        """Rough corners (n, 2). Full tries only where a small copy of the image shows a board at all."""
        equalised = cv2.equalizeHist(grey)
        first, second = (equalised, grey) if grey.mean() < _DARK else (grey, equalised)
        ok, corners = cv2.findChessboardCorners(first, self._size, flags=_CLASSIC | cv2.CALIB_CB_FAST_CHECK)
        tries = 0
        while not ok and tries < 3:
            if tries == 0:
                ok, corners = cv2.findChessboardCornersSB(first, self._size, flags=0)
            elif tries == 1:
                ok, corners = cv2.findChessboardCorners(first, self._size, flags=_CLASSIC)
            else:
                ok, corners = cv2.findChessboardCorners(second, self._size, flags=_CLASSIC)
            tries += 1
        return np.asarray(corners, dtype=float).reshape(-1, 2) if ok else None


def right_handed(corners: Array, columns: int, rows: int) -> Array:
    """The grid's corners with rows reversed if needed, so that z = x cross y points into the board."""
    grid = corners.reshape(rows, columns, 2)
    x, y = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if x[0] * y[1] - x[1] * y[0] < 0.0:
        grid = grid[::-1]
    return np.ascontiguousarray(grid).reshape(-1, 2)
