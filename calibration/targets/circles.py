"""Circle grids, plain or with one corner circle larger than the others."""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.targets.base import Detection, Ids, Image, as_grey, grid_points, grid_symmetries
from calibration.targets.chessboard import right_handed
from cell.poses import Array


class CircleGridTarget:
    """Circle centres row by row, origin at the first; with ``large_dot_corner`` that is the large one.

    Rows run along ``columns``. Where the large dot sits at a corner from which that numbering runs the
    other way round, z points out of the board instead of into it: points in a plane allow both.
    """

    def __init__(self, columns: int, rows: int, spacing_m: float, large_dot_corner: bool = False) -> None:
        self._size = (columns, rows)
        self._large_dot = large_dot_corner
        self.points = grid_points(columns, rows, spacing_m)
        identity = np.arange(columns * rows, dtype=np.int64)
        self.symmetries: Sequence[Ids] = [identity] if large_dot_corner else grid_symmetries(columns, rows)

    def detect(self, image: Image) -> Detection | None:
        grey = as_grey(image)
        for candidate in (grey, cv2.equalizeHist(grey), cv2.bitwise_not(grey)):
            for flags in (cv2.CALIB_CB_SYMMETRIC_GRID, cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING):
                ok, centres = cv2.findCirclesGrid(
                    candidate, self._size, flags=flags, blobDetector=_blob_detector(grey.size)
                )
                if ok:
                    return self._number(candidate, np.asarray(centres, dtype=float).reshape(-1, 2))
        return None

    def _number(self, grey: Image, centres: Array) -> Detection | None:
        columns, rows = self._size
        grid = right_handed(centres, columns, rows)
        ids = np.arange(columns * rows, dtype=np.int64)
        if not self._large_dot:
            return Detection(ids, grid)
        corners = [0, columns - 1, (rows - 1) * columns, rows * columns - 1]
        areas = np.array([_dark_area(grey, grid, k) for k in corners])
        largest = int(np.argmax(areas))
        if areas[largest] < 1.2 * np.partition(areas, -2)[-2]:
            return None  # no corner circle stands out, so the numbering would be a guess
        table = grid.reshape(rows, columns, 2)
        if columns == rows:
            table = np.rot90(table, {0: 0, 1: 1, 3: 2, 2: 3}[largest])
        else:
            table = table[:, ::-1] if largest in (1, 3) else table
            table = table[::-1] if largest in (2, 3) else table
        return Detection(ids, np.ascontiguousarray(table).reshape(-1, 2))


def _blob_detector(pixels: int) -> cv2.SimpleBlobDetector:
    """Blobs of any size up to a hundredth of the image; OpenCV's default stops at 5000 pixels."""
    params = cv2.SimpleBlobDetector.Params()
    params.minArea, params.maxArea = 20.0, max(5000.0, pixels / 100.0)
    params.minDistBetweenBlobs = 5.0
    params.thresholdStep = 20.0
    return cv2.SimpleBlobDetector.create(params)


def _dark_area(grey: Image, centres: Array, k: int) -> float:
    """Dark pixels that hang together with centre ``k``."""
    distances = np.linalg.norm(centres - centres[k], axis=1)
    half = max(2, int(0.6 * np.partition(distances, 1)[1]))
    u, v = (round(x) for x in centres[k])
    patch = grey[max(0, v - half) : v + half + 1, max(0, u - half) : u + half + 1]
    _, dark = cv2.threshold(patch, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
    _, labels = cv2.connectedComponents(dark)
    own = labels[min(v, half), min(u, half)]
    return float(np.count_nonzero(labels == own)) if own else 0.0
