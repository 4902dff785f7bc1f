"""Whether a camera would see the whole board."""

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.devices import Intrinsics
from cell.poses import Array

MAX_INCIDENCE_RAD = 1.05  # 60 degrees; corners of flatter boards are found badly


def project(points_camera: Array, intrinsics: Intrinsics) -> Array:
    """Pixels (..., 2) of points (..., 3) in the camera frame, with OpenCV's distortion."""
    flat = points_camera.reshape(-1, 1, 3)
    dist = np.array(intrinsics.dist, dtype=float)
    pixels, _ = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), intrinsics.matrix, dist)
    return np.asarray(pixels, dtype=float).reshape(*points_camera.shape[:-1], 2)


def view_faults(
    T_camera_target: RigidTransform, target_points: ArrayLike, intrinsics: Intrinsics, margin_px: float
) -> list[str | None]:
    """For each view (n): why the board (m, 3) cannot be used there, or None.

    All points have to be in front of the camera and ``margin_px`` inside the image, and the board not too
    flat to the line of sight.
    """
    board = np.asarray(target_points, dtype=float)
    poses = T_camera_target.as_matrix().reshape(-1, 4, 4)
    points = board @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    return [_fault(p, pose, intrinsics, margin_px) for p, pose in zip(points, poses, strict=True)]


def _fault(points: Array, T_camera_target: Array, intrinsics: Intrinsics, margin_px: float) -> str | None:
    if np.min(points[:, 2]) <= 0.0:
        return "part of the board would be behind the camera"
    sight = points.mean(axis=0)
    cosine = abs(T_camera_target[:3, 2] @ sight) / np.linalg.norm(sight)
    incidence = float(np.arccos(np.clip(cosine, 0.0, 1.0)))
    if incidence > MAX_INCIDENCE_RAD:
        return f"the board would be seen at {np.degrees(incidence):.0f} degrees to its normal, limit 60"
    # A distortion model may fold far points back into the image: they have to be near it without distortion.
    fx, fy, cx, cy = intrinsics.K
    size = np.array([intrinsics.width, intrinsics.height])
    plain = points[:, :2] / points[:, 2:] * [fx, fy] + [cx, cy]
    if np.any(plain < -0.5 * size) or np.any(plain > 1.5 * size):
        return "part of the board would be far outside the image"
    pixels = project(points, intrinsics)
    room = float(np.min(np.minimum(pixels, size - 1.0 - pixels)))
    if room < margin_px:
        return f"the board would come within {room:.0f} px of the image's edge, need {margin_px:.0f} px"
    return None
