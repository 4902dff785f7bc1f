"""Targets from the ``target`` table of a data set or of ``cell.toml``."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from calibration.targets.base import Detection, Ids, Image, Target
from calibration.targets.charuco import CharucoTarget
from calibration.targets.chessboard import ChessboardTarget
from calibration.targets.circles import CircleGridTarget
from calibration.targets.marker import MarkerTarget
from cell.errors import error
from cell.poses import Array

MIN_MARKER_M = 1e-4  # OpenCV keeps lengths in single precision and fails at 0


class PointsTarget:
    """Points given by the data set, with their image coordinates beside each pose."""

    def __init__(self, points: Array) -> None:
        self.points = points
        self.symmetries: Sequence[Ids] = [np.arange(len(points), dtype=np.int64)]

    def detect(self, image: Image) -> Detection | None:
        """Given points have no look, so they are found in no image."""
        del image
        return None


def make_target(spec: Mapping[str, Any]) -> Target:
    """The target that ``spec`` describes (keys as in a capture set's ``target``), ready to detect.

    Raises ``DATA_INVALID`` for a type, dictionary or size that does not exist.
    """
    kind = spec.get("type")
    if kind == "charuco":
        if not MIN_MARKER_M <= spec["marker_m"] < spec["square_m"]:
            raise error(
                "DATA_INVALID",
                f"target.marker_m is {spec['marker_m']} m; it must be at least {MIN_MARKER_M:g} m, smaller "
                f"than square_m ({spec['square_m']} m)",
            )
        return CharucoTarget(
            int(spec["squares_x"]),
            int(spec["squares_y"]),
            float(spec["square_m"]),
            float(spec["marker_m"]),
            _dictionary(spec["dictionary"]),
            bool(spec.get("legacy", False)),
        )
    if kind == "chessboard":
        return ChessboardTarget(int(spec["columns"]), int(spec["rows"]), float(spec["square_m"]))
    if kind == "circle-grid":
        large_dot = bool(spec.get("large_dot_corner", False))
        return CircleGridTarget(int(spec["columns"]), int(spec["rows"]), float(spec["spacing_m"]), large_dot)
    if kind == "aruco-marker":
        return MarkerTarget(_dictionary(spec["dictionary"]), int(spec["id"]), float(spec["size_m"]))
    if kind == "points":
        return PointsTarget(np.asarray(spec["points"], dtype=float).reshape(-1, 3))
    raise error(
        "DATA_INVALID",
        f"target.type is {kind!r}; it must be charuco, chessboard, circle-grid, aruco-marker or points",
    )


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    number = getattr(cv2.aruco, name, None) if name.startswith("DICT_") else None
    if not isinstance(number, int):
        raise error(
            "DATA_INVALID",
            f"target.dictionary is {name!r}; it must be one of OpenCV's names, such as DICT_5X5_100",
        )
    return cv2.aruco.getPredefinedDictionary(number)
