"""The tool's point held over points of a target that a camera on the flange has located.

The camera sees the target from one pose of the arm, and the tool's point stands over its points at others.
With the true poses the point is where the target has it; how far off it is says what tool, camera and arm
together err by. For small motions ``xi`` on the right of each pose, and on the left of the target's pose C in
the camera, the point ``b`` of the target is off by

    e = H_i xi_i + G_i (x + c + Ad(X^-1) xi_look) + R_i d,

``d`` the error of the tool's point on the flange: the derivatives below, all in the target's frame.
"""

from dataclasses import dataclass

import numpy as np

from calibration.hand_eye import se3
from cell.poses import Array, adjoint


@dataclass(frozen=True)
class Standing:
    """``flange_look`` (4, 4) and ``flange`` (k, 4, 4) in the base, ``X`` (4, 4) T_flange_camera, ``C`` (4, 4)
    T_camera_target, ``tool`` (3,) m on the flange, and ``places`` (k, 3) m in the target, where the tool's
    point truly stands."""

    flange_look: Array
    flange: Array
    X: Array
    C: Array
    tool: Array
    places: Array


@dataclass(frozen=True)
class PointsOff:
    """``off`` (k, 3) m in the target: where the tool's point is said to be, less where it stands. And what a
    small motion adds to it: of the camera or of the target in it (k, 3, 6), of the flange at the look
    (k, 3, 6) and at each point (k, 3, 6), of the tool's point on the flange (k, 3, 3)."""

    off: Array
    by_camera: Array
    by_look: Array
    by_flange: Array
    by_tool: Array


def points_off(of: Standing) -> PointsOff:
    """How far off each point is, and its derivatives."""
    k = len(of.places)
    to_target = se3.inverse(of.flange_look @ of.X @ of.C) @ of.flange
    R = to_target[:, :3, :3]
    off = R @ of.tool + to_target[:, :3, 3] - of.places
    seen = of.places @ of.C[:3, :3].T + of.C[:3, 3]
    eye = np.broadcast_to(np.eye(3), (k, 3, 3))
    by_camera = -of.C[:3, :3].T @ np.concatenate([eye, -se3.hat(seen)], axis=2)
    by_flange = R @ np.concatenate([np.eye(3), -se3.hat(of.tool)], axis=1)
    return PointsOff(off, by_camera, by_camera @ adjoint(se3.inverse(of.X)), by_flange, R)


def over_points(points: Array, C: Array, stand_off_m: float) -> Array:
    """(k, 3) m in the target: the places ``stand_off_m`` in front of its ``points`` (k, 3), on the side from
    which the camera sees it as ``C`` (4, 4)."""
    return np.asarray(points + stand_off_m * towards_camera(C) * np.array([0.0, 0.0, 1.0]))


def towards_camera(C: Array) -> float:
    """1 where z of a target that is seen as ``C`` (4, 4) points to the camera's side, else -1."""
    return -1.0 if C[:3, 2] @ C[:3, 3] > 0.0 else 1.0


@dataclass(frozen=True)
class CommonMotion:
    """What all points are off by together: ``shift`` (3,) m at the middle of the points and ``turn`` (3,)
    rad about it; ``by_points`` (6, 3k) is how they follow from what each point is off by, and ``left`` (k, 3)
    m what they leave."""

    shift: Array
    turn: Array
    by_points: Array
    left: Array


def common_motion(places: Array, off: Array) -> CommonMotion:
    """Of ``places`` (k, 3) that are ``off`` (k, 3) m, by least squares; three or more, not on a line."""
    k = len(places)
    eye = np.broadcast_to(np.eye(3), (k, 3, 3))
    A = np.concatenate([eye, -se3.hat(places - places.mean(axis=0))], axis=2).reshape(3 * k, 6)
    by_points = np.linalg.pinv(A)
    xi = by_points @ off.ravel()
    return CommonMotion(xi[:3], xi[3:], by_points, off - (A @ xi).reshape(k, 3))


def outermost(points: Array) -> list[int]:
    """The four of ``points`` (n, 3) in a target's plane that are farthest out along its diagonals, in their
    order around it."""
    size = np.maximum(np.ptp(points[:, :2], axis=0), 1e-9)
    u, v = ((points[:, :2] - points[:, :2].mean(axis=0)) / size).T
    return [int(np.argmax(a * u + b * v)) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
