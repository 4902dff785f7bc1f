"""A rectangle of known size before a camera: its rim as points with the way out of it, in the picture.

Its frame: origin in the middle, x along the width, y along the height, z away from the viewer.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.devices import Intrinsics
from cell.poses import Array, exp_xi

PER_SIDE = 48
_KEEP = 0.8  # of a side: near a corner two edges blur into each other
_STEP_M, _STEP_RAD = 1e-5, 1e-5


@dataclass(frozen=True)
class Rectangle:
    """``width`` along x and ``height`` along y, m."""

    width: float
    height: float

    def rim(self) -> Array:
        """(4, PER_SIDE, 3) points of its sides: left, right, upper, lower."""
        s = np.linspace(-0.5 * _KEEP, 0.5 * _KEEP, PER_SIDE)
        rim = np.zeros((4, PER_SIDE, 3))
        rim[0, :, 0], rim[1, :, 0] = -0.5 * self.width, 0.5 * self.width
        rim[2, :, 1], rim[3, :, 1] = -0.5 * self.height, 0.5 * self.height
        rim[:2, :, 1], rim[2:, :, 0] = s * self.height, s * self.width
        return rim

    def corners(self) -> Array:
        """(4, 3), around."""
        x, y = 0.5 * self.width, 0.5 * self.height
        return np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])


OUTWARD = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])


def project(camera: Intrinsics, T_camera: RigidTransform, points: Array) -> Array:
    """(n, 2) px of ``points`` (n, 3), m, of the frame that ``T_camera`` places in the camera."""
    in_camera = np.ascontiguousarray(T_camera.apply(points))
    dist = np.array(camera.dist, dtype=float) if camera.dist else None
    pixels, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), camera.matrix, dist)
    return np.asarray(pixels, dtype=float).reshape(-1, 2)


def outward_px(camera: Intrinsics, T_camera: RigidTransform, rectangle: Rectangle) -> tuple[Array, Array]:
    """(4, n, 2) px of the rim, and (4, n, 2) the unit direction out of it in the picture."""
    rim = rectangle.rim()
    step = 0.01 * min(rectangle.width, rectangle.height)
    beyond = rim + step * OUTWARD[:, None]
    here = project(camera, T_camera, rim.reshape(-1, 3)).reshape(4, -1, 2)
    there = project(camera, T_camera, beyond.reshape(-1, 3)).reshape(4, -1, 2)
    way = there - here
    return here, way / np.linalg.norm(way, axis=2)[..., None]


def motion_px(camera: Intrinsics, T_camera: RigidTransform, points: Array) -> Array:
    """(n, 2, 6): how the pixels of ``points`` (n, 3) move with a motion of their frame, on its right."""
    columns = []
    for k in range(6):
        step = _STEP_M if k < 3 else _STEP_RAD
        xi = np.zeros(6)
        xi[k] = step
        ends = (project(camera, T_camera * exp_xi(sign * xi), points) for sign in (1.0, -1.0))
        columns.append((next(ends) - next(ends)) / (2.0 * step))
    return np.stack(columns, axis=2)
