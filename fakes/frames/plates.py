"""What hangs in front of the camera: printed targets as textures with exact geometry.

A texture is held at several resolutions, because sampling one far above or below the image's own makes
corners jump. Each halving averages 2x2 pixels, so that the pixel centres of level ``l`` lie at
``2^l (u + 1/2) - 1/2`` of level 0.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.errors import error
from cell.poses import Array
from fakes.world.camera.printed import Printed

Image = NDArray[np.uint8]

_LEVELS = 5
_PX_PER_CELL = 128  # of level 0; a power of two keeps square edges between pixels on every level
_MARGIN_CELLS = 0.5  # white border around the print


@dataclass(frozen=True)
class Plate:
    """A printed plate, flat but for ``print``. ``corner`` is the position (m) of level 0's upper left *edge*.

    ``right`` and ``down`` are the directions of growing u and v in the target's frame, so their cross
    product points into the plate; their lengths are how much the print is stretched.
    """

    levels: tuple[Image, ...]
    m_per_px: float
    corner: Array  # (3,)
    right: Array  # (3,)
    down: Array  # (3,)
    print: Printed = field(default_factory=Printed)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width along ``right`` and height along ``down`` as designed, margin included."""
        rows, columns = self.levels[0].shape
        return columns * self.m_per_px, rows * self.m_per_px

    def texture_to_target(self, level: int) -> Array:
        """(3, 3) matrix from pixels (u, v, 1) of ``level`` to points (m) of the flat target."""
        pitch = self.m_per_px * 2**level
        first_centre = self.corner + 0.5 * pitch * (self.right + self.down)
        return np.column_stack([pitch * self.right, pitch * self.down, first_centre])

    def outline(self, per_edge: int = 8) -> Array:
        """Points along the plate's rim, shape (4 per_edge, 3), in order: a curved rim stays a curve."""
        width, height = self.size_m
        s = np.arange(per_edge) / per_edge
        zeros, ones = np.zeros(per_edge), np.ones(per_edge)
        u = np.concatenate([s, ones, 1 - s, zeros]) * width
        v = np.concatenate([zeros, s, ones, 1 - s]) * height
        return self.print.bowed(self.corner + u[:, None] * self.right + v[:, None] * self.down)


def make_plate(target: Mapping[str, Any], printed: Printed | None = None) -> Plate:
    """The plate of a capture set's ``target`` table; ``DATA_INVALID`` for a type it cannot draw."""
    draw = _DRAWERS.get(str(target.get("type")))
    if draw is None:
        raise error(
            "DATA_INVALID", f"the twin cannot draw a target of type {target.get('type')!r}; it draws {_NAMES}"
        )
    plate = draw(target)
    if printed is None:
        return plate
    corner, right, down = (printed.stretch * v for v in (plate.corner, plate.right, plate.down))
    return replace(plate, corner=corner, right=right, down=down, print=printed)


def _plate(print_: Image, cell_m: float, origin_px: tuple[float, float], y_up: bool = False) -> Plate:
    """Put a white margin around ``print_``; ``origin_px`` is the target's origin as pixel edges of it."""
    margin = int(_MARGIN_CELLS * _PX_PER_CELL)
    # A multiple of the coarsest level's step, so that every halving is exact.
    grow = [-(size + 2 * margin) % 2**_LEVELS for size in print_.shape]
    full = cv2.copyMakeBorder(
        print_, margin, margin + grow[0], margin, margin + grow[1], cv2.BORDER_CONSTANT, value=255
    )
    levels = [full]
    for _ in range(_LEVELS - 1):
        rows, columns = levels[-1].shape
        levels.append(cv2.resize(levels[-1], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA))
    pitch = cell_m / _PX_PER_CELL
    down = np.array([0.0, -1.0 if y_up else 1.0, 0.0])
    right = np.array([1.0, 0.0, 0.0])
    corner = -pitch * ((origin_px[0] + margin) * right + (origin_px[1] + margin) * down)
    return Plate(tuple(levels), pitch, corner, right, down)


def _charuco(target: Mapping[str, Any]) -> Plate:
    columns, rows = int(target["squares_x"]), int(target["squares_y"])
    board = cv2.aruco.CharucoBoard(
        (columns, rows), float(target["square_m"]), float(target["marker_m"]), _dictionary(target)
    )
    board.setLegacyPattern(bool(target.get("legacy", False)))
    print_ = board.generateImage((columns * _PX_PER_CELL, rows * _PX_PER_CELL), marginSize=0, borderBits=1)
    return _plate(print_, float(target["square_m"]), (0.0, 0.0))


def _chessboard(target: Mapping[str, Any]) -> Plate:
    columns, rows = int(target["columns"]) + 1, int(target["rows"]) + 1
    black = np.indices((rows, columns)).sum(axis=0) % 2 == 0
    print_ = np.kron(np.where(black, 0, 255), np.ones((_PX_PER_CELL, _PX_PER_CELL))).astype(np.uint8)
    return _plate(print_, float(target["square_m"]), (_PX_PER_CELL, _PX_PER_CELL))


def _circle_grid(target: Mapping[str, Any]) -> Plate:
    columns, rows = int(target["columns"]), int(target["rows"])
    print_ = np.full((rows * _PX_PER_CELL, columns * _PX_PER_CELL), 255, np.uint8)
    shift = 4  # cv2's fixed-point bits: circle centres lie between pixels
    for row in range(rows):
        for column in range(columns):
            large = bool(target.get("large_dot_corner")) and row == column == 0
            centre = [int(((k + 0.5) * _PX_PER_CELL - 0.5) * 2**shift) for k in (column, row)]
            radius = int((0.36 if large else 0.24) * _PX_PER_CELL * 2**shift)
            cv2.circle(print_, centre, radius, 0, -1, cv2.LINE_AA, shift)
    return _plate(print_, float(target["spacing_m"]), (0.5 * _PX_PER_CELL, 0.5 * _PX_PER_CELL))


def _aruco_marker(target: Mapping[str, Any]) -> Plate:
    marker = marker_cells(str(target["dictionary"]), int(target["id"]))
    bits = len(marker)
    print_ = np.kron(marker, np.ones((_PX_PER_CELL, _PX_PER_CELL), np.uint8))
    half = 0.5 * bits * _PX_PER_CELL
    return _plate(print_, float(target["size_m"]) / bits, (half, half), y_up=True)


def marker_cells(dictionary: str, number: int) -> Image:
    """(n, n): the cells of a marker with its border, 0 black and 255 white, the upper row first."""
    known = _dictionary({"dictionary": dictionary})
    bits = known.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(known, number, bits, borderBits=1), dtype=np.uint8)


def _dictionary(target: Mapping[str, Any]) -> cv2.aruco.Dictionary:
    number = getattr(cv2.aruco, str(target["dictionary"]), None)
    if not isinstance(number, int):
        raise error("DATA_INVALID", f"{target['dictionary']!r} is not a dictionary that OpenCV knows")
    return cv2.aruco.getPredefinedDictionary(number)


_DRAWERS: dict[str, Callable[[Mapping[str, Any]], Plate]] = {
    "charuco": _charuco,
    "chessboard": _chessboard,
    "circle-grid": _circle_grid,
    "aruco-marker": _aruco_marker,
}
_NAMES = ", ".join(_DRAWERS)
