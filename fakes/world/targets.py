"""Points of calibration targets in their own frame, from the ``target`` table of a data set."""

from typing import Any

import numpy as np

from cell.errors import error
from cell.poses import Array


def target_points(target: dict[str, Any]) -> Array:
    """Points (n, 3) in metres, in the order of their ids.

    ChArUco: inner corners row by row, origin at the board's outer corner, z into the board. Chessboard and
    circle grid: row by row from the first point. Marker: corners clockwise from the top left, z out of it.
    """
    kind = target.get("type")
    if kind == "charuco":
        return _grid(target["squares_x"] - 1, target["squares_y"] - 1, target["square_m"], first=1)
    if kind == "chessboard":
        return _grid(target["columns"], target["rows"], target["square_m"])
    if kind == "circle-grid":
        return _grid(target["columns"], target["rows"], target["spacing_m"])
    if kind == "aruco-marker":
        h = target["size_m"] / 2.0
        return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
    if kind == "points":
        return np.array(target["points"], dtype=float).reshape(-1, 3)
    raise error("CONFIG_INVALID", f"target type {kind!r} is not known")


def faces_away(target: dict[str, Any]) -> float:
    """+1 where the target's z points into it, so away from who sees it; -1 where it points out."""
    return -1.0 if target.get("type") == "aruco-marker" else 1.0


def _grid(columns: int, rows: int, pitch: float, first: int = 0) -> Array:
    y, x = np.mgrid[first : first + rows, first : first + columns]
    return np.stack([x.ravel() * pitch, y.ravel() * pitch, np.zeros(columns * rows)], axis=1)
