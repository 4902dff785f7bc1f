"""Simulated data sets of a fixed camera and a target on the flange, with the whole truth.

The arm is that of :mod:`tests.kit.imperfect_cell`: its chain, its gears and its sag are not as its model. The
camera is the true one in the true base, and the target sits on the true flange.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.hand_eye import se3
from cell.devices import Intrinsics
from cell.poses import Array, to_pose6
from tests.kit.imperfect_cell import ARM, CAMERA, FLANGE_R, FLANGE_T, MODEL, PX, World, world

POINTS = np.array([[0.03 * x, 0.03 * y, 0.0] for y in range(6) for x in range(8)]) - [0.105, 0.075, 0.0]
SIGMA_C_T, SIGMA_C_R = 1e-4, 3e-4
POSE_T, POSE_R = 5e-5, 2e-4  # of a T_camera_marker
_CENTRE, _SIDE = np.array([0.55, 0.15, 0.45]), np.array([0.3, 0.3, 0.25])  # where the marker works, m
_TURN = 0.9  # rad, of the marker away from the camera, at most
_MARKER_ON_FLANGE = RigidTransform.from_components(
    [0.01, 0.06, 0.05], Rotation.from_euler("xyz", [0.1, -0.5, 0.3])
)
_CAMERA_IN_BASE = RigidTransform.from_components(
    [1.40, -0.35, 0.65], Rotation.from_matrix([[0.55, 0.2, -0.8], [0.8, -0.3, 0.5], [-0.1, -0.9, -0.3]])
)


@dataclass(frozen=True)
class EyeToHandScene:
    """``cell`` is the arm as it is; ``X`` T_base_camera, ``W`` T_flange_target, (4, 4), for its true base and
    flange. ``Q`` (n, 6) joints, ``F`` (n, 4, 4) flange as reported, ``C`` (n, 4, 4) T_camera_target as it
    truly was, ``corners`` (n, m, 2) px as seen."""

    cell: World
    X: Array
    W: Array
    Q: Array
    F: Array
    C: Array
    corners: Array

    @property
    def X_serving(self) -> Array:
        """(4, 4) T_base_camera for the base that serves the nominal arm best, as a hand-eye has it."""
        return np.asarray(se3.inverse(self.cell.base) @ self.X)

    def marker(self, Q: Array) -> Array:
        """(k, 4, 4) where the camera would see the target at joints ``Q`` (k, 6), without noise."""
        return se3.inverse(self.X) @ self.cell.true_flange(Q) @ self.W

    def data_set(
        self,
        rng: np.random.Generator,
        *,
        C_off: tuple[float, float] = (0.0, 0.0),
        X_off: tuple[float, float] = (0.0, 0.0),
        poses: bool = False,
        with_joints: bool = True,
    ) -> dict[str, object]:
        """The ``cellward.axbc/1``; C and X as given are off by (m, rad) in directions of chance.

        ``poses``: T_camera_marker with the noise of a good camera instead of corners.
        """
        C = se3.inverse(self.W) @ off(rng, *C_off)
        X = se3.inverse(self.X_serving) @ off(rng, *X_off)
        observations = []
        for q, F, T, uv in zip(self.Q, self.F, self.C, self.corners, strict=True):
            seen: dict[str, object] = {"corners": uv.tolist()}
            if poses:
                seen = {
                    "T_camera_marker": pose6(T @ se3.exp(rng.normal(size=6) * np.repeat([POSE_T, POSE_R], 3)))
                }
            if with_joints:
                seen["q"] = q.tolist()
            observations.append({"T_base_flange": pose6(F), **seen})
        return {
            "schema": "cellward.axbc/1",
            "robot": {"model": "ur10e"},
            "camera": {
                "width": CAMERA.width,
                "height": CAMERA.height,
                "K": list(CAMERA.K),
                "dist": list(CAMERA.dist),
            },
            "marker": {"type": "points", "points": POINTS.tolist(), "scale_sigma": 1e-4, "flatness_m": 2e-5},
            "T_marker_flange": pose6(C),
            "sigma_C": {"t": SIGMA_C_T, "r": SIGMA_C_R},
            "X_measured_T_camera_base": pose6(X),
            "observations": observations,
        }


def make_scene(
    rng: np.random.Generator, n: int = 60, arm_m: float = 2e-4, gear_rad: float = 2e-5, sag_rad: float = 1e-4
) -> EyeToHandScene:
    """``n`` poses over the volume; ``arm_m`` as in :func:`tests.kit.imperfect_cell.world`."""
    cell = world(rng, arm_m, "exact", "exact", gear_rad, sag_rad)
    R = _CAMERA_IN_BASE.rotation
    toward = _CENTRE - _CAMERA_IN_BASE.translation
    X = _looking(_CAMERA_IN_BASE.translation, toward, R) @ off(rng, 0.02, 0.05)
    W = _MARKER_ON_FLANGE.as_matrix() @ off(rng, 0.005, 0.05)
    Q = joints(rng, X, W, n)
    F = MODEL.base.flange(Q)
    noise = se3.exp(rng.normal(size=(n, 6)) * np.repeat([FLANGE_T, FLANGE_R], 3))
    C = se3.inverse(X) @ cell.true_flange(Q) @ noise @ W
    corners = np.array([project(T) for T in C])
    return EyeToHandScene(cell, X, W, Q, F, C, corners + rng.normal(size=corners.shape) * PX)


def joints(rng: np.random.Generator, X: Array, W: Array, n: int) -> Array:
    """(n, 6) that bring the target to places of chance in the volume, turned to the camera, in its view."""
    out: list[Array] = []
    while len(out) < n:
        p = _CENTRE + (rng.random(3) - 0.5) * _SIDE
        away = p - X[:3, 3]
        facing = _looking(p, away, Rotation.from_matrix(X[:3, :3]))
        turn = Rotation.from_rotvec(_chance(rng) * _TURN * rng.random()) * Rotation.from_rotvec(
            [0, 0, rng.uniform(-1, 1)]
        )
        T = facing.copy()
        T[:3, :3] = facing[:3, :3] @ turn.as_matrix()
        uv = project(se3.inverse(X) @ T)
        if np.any(uv < 20.0) or np.any(uv > [CAMERA.width - 20.0, CAMERA.height - 20.0]):
            continue
        found = ARM.inverse_all(RigidTransform.from_matrix(T @ se3.inverse(W)))
        if found:
            out.append(found[rng.integers(len(found))])
    return np.array(out)


def off(rng: np.random.Generator, t: float, r: float) -> Array:
    """(4, 4) a motion of ``t`` m and ``r`` rad in directions of chance."""
    out: Array = se3.exp(np.concatenate([t * _chance(rng), r * _chance(rng)])[None])[0]
    return out


def pose6(T: Array) -> list[float]:
    """Of (4, 4), as in a file."""
    return [float(v) for v in to_pose6(RigidTransform.from_matrix(T))]


def _chance(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _looking(p: Array, along: Array, near: Rotation) -> Array:
    """(4, 4) at ``p`` with z ``along`` and x as near as may be to that of ``near``."""
    z = along / np.linalg.norm(along)
    x = near.as_matrix()[:, 0]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), p
    return T


def project(T: Array, lens: Intrinsics = CAMERA) -> Array:
    """Pixels (m, 2) of the target's points at its pose ``T`` (4, 4) in the camera."""
    dist = np.array(lens.dist) if lens.dist else None
    uv, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], lens.matrix, dist)
    return np.asarray(uv, dtype=float).reshape(-1, 2)
