"""ChArUco boards: chessboard corners numbered by the markers between them."""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.targets.base import Detection, Ids, Image, as_grey, grid_points, refine_corners
from cell.poses import Array


class CharucoTarget:
    """Inner corners of OpenCV's ChArUco board, row by row, origin at the outer corner, z into the board."""

    def __init__(
        self,
        squares_x: int,
        squares_y: int,
        square_m: float,
        marker_m: float,
        dictionary: cv2.aruco.Dictionary,
        legacy: bool = False,
    ) -> None:
        board = cv2.aruco.CharucoBoard((squares_x, squares_y), square_m, marker_m, dictionary)
        board.setLegacyPattern(legacy)
        charuco, markers = cv2.aruco.CharucoParameters(), cv2.aruco.DetectorParameters()
        charuco.minMarkers = 2
        markers.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        self._detector = cv2.aruco.CharucoDetector(board, charuco, markers)
        self._columns = squares_x - 1
        self._gap_squares = (square_m - marker_m) / 2.0 / square_m
        self.points = grid_points(squares_x - 1, squares_y - 1, square_m, first=1)
        self.symmetries: Sequence[Ids] = [np.arange(len(self.points), dtype=np.int64)]

    def detect(self, image: Image) -> Detection | None:
        grey = as_grey(image)
        corners, ids, marker_corners, _ = self._detector.detectBoard(grey)
        if ids is None or len(ids) == 0:
            return None
        order = np.argsort(ids.ravel())
        found = np.asarray(ids).ravel()[order].astype(np.int64)
        rough = np.asarray(corners, dtype=float).reshape(-1, 2)[order]
        gap = self._gap_squares * self._square_px(found, rough, marker_corners)
        return Detection(found, refine_corners(grey, rough, gap))

    def _square_px(self, ids: Ids, corners: Array, marker_corners: Sequence[Array]) -> Array:
        """Local size (n,) of a square in pixels: distance to the nearest found neighbour in the grid.

        A corner without one takes the size of the smallest marker, which is on the safe side.
        """
        sides = [np.linalg.norm(np.diff(m.reshape(4, 2), axis=0), axis=1).min() for m in marker_corners]
        size = np.full(len(ids), min(sides) if sides else 10.0)
        at = {int(i): k for k, i in enumerate(ids)}
        for k, i in enumerate(ids):
            column = int(i) % self._columns
            near = [int(i) - self._columns, int(i) + self._columns]
            near += [int(i) - 1] * (column > 0) + [int(i) + 1] * (column < self._columns - 1)
            steps = [float(np.linalg.norm(corners[at[j]] - corners[k])) for j in near if j in at]
            if steps:
                size[k] = min(steps)
        return size
