"""A single ArUco marker or AprilTag."""

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.targets.base import Detection, Ids, Image, as_grey, refine_corners


class MarkerTarget:
    """Corners clockwise from the top left; origin at the centre, y up, z out of the marker."""

    def __init__(self, dictionary: cv2.aruco.Dictionary, marker_id: int, size_m: float) -> None:
        params = cv2.aruco.DetectorParameters()
        params.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        self._detector = cv2.aruco.ArucoDetector(dictionary, params)
        self._id = marker_id
        self._modules = dictionary.markerSize + 2  # with the black border
        h = size_m / 2.0
        self.points = np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
        self.symmetries: Sequence[Ids] = [np.arange(4, dtype=np.int64)]

    def detect(self, image: Image) -> Detection | None:
        grey = as_grey(image)
        markers, ids, _ = self._detector.detectMarkers(grey)
        mine = [] if ids is None else [m for m, i in zip(markers, ids.ravel(), strict=True) if i == self._id]
        if len(mine) != 1:
            return None  # two markers with the same number: which one is the target is anyone's guess
        corners = np.asarray(mine[0], dtype=float).reshape(4, 2)
        side = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
        gap = np.minimum(side, np.roll(side, -1)) / self._modules
        return Detection(np.arange(4, dtype=np.int64), refine_corners(grey, corners, gap))
