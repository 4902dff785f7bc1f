"""The cone of camera poses around a board, with constant roll, and which cones to try.

Camera poses look at the board's centre from a circle; the camera keeps its roll. A camera turned rigidly
with its generatrix would make every relative rotation share the cone's axis, and then no hand-eye method can
find the translation along it, so this module cannot produce that set.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array

TILT_RAD = 0.35  # of the tilted axes among the candidates


@dataclass(frozen=True)
class ConeShape:
    """How many poses, the cone's half angle, and the distance from the camera to the board's centre.

    With ``second_distance_m`` every other pose stands there, so that focal length and printed size can be
    told apart. The cone is gone round in ``laps``, neighbours in turn on each of them: the camera is rolled
    by ``roll_rad`` from lap to lap, the laps after the first have ``steeper_rad`` as their half angle, and
    with ``other_branch`` the arm takes each lap on another branch than the one before, where it can.
    """

    poses: int
    half_angle_rad: float
    distance_m: float
    second_distance_m: float | None = None
    laps: int = 1
    roll_rad: float = 0.0
    steeper_rad: float | None = None
    other_branch: bool = False

    def distances(self) -> Array:
        """(n,) m, in the order round the cone."""
        two = [self.distance_m, self.second_distance_m or self.distance_m]
        return np.resize(np.array(two), self.poses)

    def lap_of(self) -> NDArray[np.int64]:
        """(n,) from 0: on which lap each pose is visited. Every lap has both distances."""
        each = 1 if self.second_distance_m is None else 2
        return (np.arange(self.poses) // each) % self.laps

    def half_angles(self) -> Array:
        """(n,) rad, in the order round the cone."""
        steeper = self.half_angle_rad if self.steeper_rad is None else self.steeper_rad
        return np.where(self.lap_of() > 0, steeper, self.half_angle_rad)


@dataclass(frozen=True, eq=False)
class ConeAxis:
    """``T_target_cone``: origin at the board's centre, z from the camera into the board, x the camera's x."""

    T_target_cone: RigidTransform
    label: str


def cone_poses(T_a_cone: RigidTransform, shape: ConeShape) -> RigidTransform:
    """``T_a_camera`` (n) on the cone whose frame is ``T_a_cone`` (z along the axis, away from the cameras).

    Camera k stands at ``L (sin b cos f, sin b sin f, -cos b)`` with ``f = 2 pi k / n`` and is turned by
    ``R_k = exp(b (sin f, -cos f, 0))``: its optical axis passes the origin, its roll stays on each lap.
    """
    f = 2.0 * np.pi * np.arange(shape.poses) / shape.poses
    b, L = shape.half_angles(), shape.distances()[:, None]
    centre = L * np.stack([np.sin(b) * np.cos(f), np.sin(b) * np.sin(f), -np.cos(b)], axis=1)
    turn = np.stack([b * np.sin(f), -b * np.cos(f), np.zeros_like(f)], axis=1)
    roll = Rotation.from_rotvec(np.outer(shape.lap_of() * shape.roll_rad, [0.0, 0.0, 1.0]))
    return T_a_cone * RigidTransform.from_components(centre, Rotation.from_rotvec(turn) * roll)


def board_centre(target_points: ArrayLike) -> Array:
    """(3,) middle of the extent of the target's points (m, 3), in the target frame."""
    p = np.asarray(target_points, dtype=float)
    middle: Array = 0.5 * (p.min(axis=0) + p.max(axis=0))
    return middle


def candidate_axes(T_camera_target: RigidTransform, target_points: ArrayLike) -> list[ConeAxis]:
    """Cones to try around a board seen as ``T_camera_target``, most natural first.

    The board's normal and the present line of sight, then axes tilted off the normal, all with the camera's
    present roll; then the first two with the camera rolled by quarter turns.
    """
    centre = board_centre(target_points)
    T_target_camera = T_camera_target.inv()
    R_camera = T_target_camera.rotation
    sight = centre - T_target_camera.translation
    sight /= np.linalg.norm(sight)
    normal = np.array([0.0, 0.0, 1.0 if sight[2] >= 0.0 else -1.0])  # away from the camera
    upright = _turned_to(R_camera, normal)
    axes = [("board normal", upright), ("present line of sight", _turned_to(R_camera, sight))]
    for name, x, y in (("+x", 0, 1), ("-x", 0, -1), ("+y", -1, 0), ("-y", 1, 0)):
        tilt = Rotation.from_rotvec(TILT_RAD * np.array([x, y, 0.0]))
        axes.append((f"normal tilted {np.degrees(TILT_RAD):.0f} degrees to {name}", upright * tilt))
    for label, R in tuple(axes[:2]):
        for quarter in (1, -1, 2):
            roll = Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi * quarter])
            axes.append((f"{label}, camera rolled {90 * quarter} degrees", R * roll))
    return [ConeAxis(RigidTransform.from_components(centre, R), label) for label, R in axes]


def rotation_spread(rotations: Rotation) -> float:
    """RMS angle (rad) about the second strongest axis of rotation among ``rotations`` (n) about their mean.

    Zero when all relative rotations share one axis, which no hand-eye method can use; ``b / sqrt(2)`` for
    a full cone of half angle b.
    """
    if len(rotations) < 3:
        return 0.0
    about_mean = (rotations.mean().inv() * rotations).as_rotvec()
    singular: Array = np.linalg.svd(about_mean, compute_uv=False)
    return float(singular[1]) / float(np.sqrt(len(rotations)))


def _turned_to(R: Rotation, direction: Array) -> Rotation:
    """``R`` turned by the smallest rotation that brings its z axis to the unit vector ``direction``."""
    z = R.apply([0.0, 0.0, 1.0])
    axis = np.cross(z, direction)
    sine, cosine = float(np.linalg.norm(axis)), float(z @ direction)
    if sine < 1e-9:
        return R if cosine > 0.0 else R * Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)) * R
