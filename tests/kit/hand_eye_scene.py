"""A scene with known truth for the tests of hand-eye calibration. Poses by SciPy, images by OpenCV."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.hand_eye.solution import Measurements
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import compose, exp_xi, from_pose6, to_pose6

CAMERA = Intrinsics(1280, 800, (900.0, 905.0, 640.0, 400.0), (-0.12, 0.08, 0.001, -0.0005, 0.0))
BOARD = {
    "type": "charuco",
    "squares_x": 10,
    "squares_y": 7,
    "square_m": 0.025,
    "marker_m": 0.018,
    "dictionary": "DICT_5X5_100",
}
_Y, _X = np.mgrid[1:7, 1:10]
POINTS = np.stack([_X.ravel() * 0.025, _Y.ravel() * 0.025, np.zeros(54)], axis=1)
X_TRUE = RigidTransform.from_components([0.02, -0.08, 0.05], Rotation.from_rotvec([0.1, -0.2, 0.3]))


@dataclass
class Scene:
    """Measured corners (n, 54, 2) and flange poses, with the truth beside them."""

    setup: str
    flange: list[RigidTransform]
    camera_target: list[RigidTransform]
    corners: np.ndarray
    group: np.ndarray
    X: RigidTransform = X_TRUE

    def measurements(self, start: bool = False) -> Measurements:
        """As the solver takes them."""
        n = len(self.flange)
        C = [T.as_matrix() for T in self.camera_target]
        return Measurements(
            self.setup,  # type: ignore[arg-type]
            np.stack([T.as_matrix() for T in self.flange]),
            self.group,
            [
                CornerSet(POINTS, uv, np.ones(54), C[i] if start else None)
                for i, uv in enumerate(self.corners)
            ],
            np.tile(np.eye(4), (n, 1, 1)),
            np.eye(4)[None],
        )

    def data_set(self, **changes: Any) -> dict[str, Any]:
        """As a capture data set with corners."""
        return {
            "schema": "cellward.capture/1",
            "setup": self.setup,
            "camera": {"width": 1280, "height": 800, "K": list(CAMERA.K), "dist": list(CAMERA.dist)},
            "target": BOARD,
            "observations": [
                {
                    "index": i,
                    "group": int(self.group[i]),
                    "corners": self.corners[i].tolist(),
                    "T_base_flange": to_pose6(T).tolist(),
                }
                for i, T in enumerate(self.flange)
            ],
            **changes,
        }

    def write(self, folder: Path, **changes: Any) -> Path:
        """The data set on disk."""
        path = folder / "capture.json"
        path.write_text(json.dumps(self.data_set(**changes)), "utf-8")
        return path


def cone_views(rng: np.random.Generator, count: int, half_angle: float = 0.44) -> list[RigidTransform]:
    """T_camera_target on a cone about the board's centre, roll kept up to a little."""
    out = []
    for k in range(count):
        f, b = 2 * np.pi * k / count + rng.normal() * 0.2, half_angle * rng.uniform(0.5, 1.2)
        R = Rotation.from_rotvec([b * np.sin(f), -b * np.cos(f), 0]) * Rotation.from_rotvec(
            [0, 0, rng.normal() * 0.3]
        )
        centre = np.array([0, 0, 0.5 * rng.uniform(0.9, 1.1)])
        out.append(from_pose6([*(centre - R.apply(POINTS.mean(axis=0))), *R.as_rotvec()]))
    return out


def make_scene(
    seed: int = 0,
    setup: str = "eye-in-hand",
    count: int = 20,
    groups: int = 1,
    px: float = 0.2,
    flange_t: float = 2e-4,
    flange_r: float = 2e-4,
    views: list[RigidTransform] | None = None,
) -> Scene:
    """``count`` observations dealt over ``groups`` placements, with noise on corners and flange poses."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(groups), count // groups)
    seen = views or [T for _ in range(groups) for T in cone_views(rng, count // groups)]
    placed = [exp_xi(np.r_[rng.normal(size=3) * 0.2, rng.normal(size=3) * 0.4]) for _ in range(groups)]
    flange, corners = [], []
    for g, C in zip(group, seen, strict=True):
        way = (placed[g], C.inv(), X_TRUE.inv()) if setup == "eye-in-hand" else (X_TRUE, C, placed[g].inv())
        noise = from_pose6([*(rng.normal(size=3) * flange_t), *(rng.normal(size=3) * flange_r)])
        flange.append(compose(*way, noise))
        t, r = np.split(to_pose6(C), 2)
        uv, _ = cv2.projectPoints(POINTS, r, t, CAMERA.matrix, np.array(CAMERA.dist))
        corners.append(uv.reshape(-1, 2) + rng.normal(size=(54, 2)) * px)
    return Scene(setup, flange, seen, np.array(corners), group)
