"""Items below a fixed camera that tells a wrong lens, placed by its pose and one lens or the other."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.lens_terms import LensPrior
from calibration.adjustment.unknowns import ArmKnown
from calibration.belt.placing import camera_cov, off_by_camera
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Solution, solve
from cell.devices import Intrinsics
from cell.poses import Array
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, capture_eye_to_hand, world

FOCAL, CENTRE_PX = 3e-3, 5.0  # by which the lens is another one than the camera tells
ITEMS = 8
INSIDE = 5.991  # chi-square of two degrees of freedom, 95 %
_LEAN = RigidTransform.from_rotation(Rotation.from_rotvec([np.pi - 0.1, 0.08, 0.0]))


@dataclass(frozen=True)
class PlacedItems:
    """``off`` (n, 2) m of items on a belt, and their stated ``cov`` (n, 2, 2)."""

    off: Array
    cov: Array

    @property
    def inside(self) -> float:
        """The share of them within the stated 95 %."""
        squared = np.einsum("ni,nij,nj->n", self.off, np.linalg.inv(self.cov), self.off)
        return float(np.mean(squared < INSIDE))


def placed_items(seed: int, distance_m: float = 0.5) -> dict[str, PlacedItems]:
    """Of one calibration with its own lens: items by the lens that the camera tells, with the ``pose`` alone
    as what is not known and with what a ``told`` lens is known to, and by the lens that was ``found``."""
    rng = np.random.default_rng([seed, 9])
    f, _, cx, cy = CAMERA.K
    f, way = f * (1.0 + rng.choice([-1.0, 1.0]) * FOCAL), rng.uniform(0.0, 2.0 * np.pi)
    K = (f, f, cx + CENTRE_PX * np.cos(way), cy + CENTRE_PX * np.sin(way))
    cell = replace(world(rng, 6e-5, "exact", "slight"), camera=replace(CAMERA, K=K))
    measured, Q, truth = capture_eye_to_hand(rng, cell)
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    found = adjust(measured, first, CAMERA, ArmKnown(MODEL, Q, ARM.joint_limits), LensPrior())
    # The base is turned so that the camera looks down at a slant, from its origin, on a level belt.
    lost = RigidTransform.from_matrix(se3.inverse(truth) @ found.X)
    rays = np.column_stack([rng.uniform(-0.6, 0.6, ITEMS), rng.uniform(-0.35, 0.35, ITEMS), np.ones(ITEMS)])
    items = _level(_LEAN.apply(rays), distance_m)
    seen, still = np.ascontiguousarray(_LEAN.inv().apply(items)), np.zeros(3)
    pixels, _ = cv2.projectPoints(seen, still, still, cell.camera.matrix, np.array(cell.camera.dist))
    pose = _LEAN * lost

    def by(lens: Intrinsics, cov: Array) -> PlacedItems:
        xy = cv2.undistortPoints(pixels, lens.matrix, np.array(lens.dist)).reshape(-1, 2)
        sights = pose.rotation.apply(np.column_stack([xy, np.ones(ITEMS)]))
        off = pose.translation + _level(sights, distance_m + pose.translation[2]) - items
        J = off_by_camera(items, pose, lens)
        return PlacedItems(off[:, :2], J @ cov @ np.swapaxes(J, 1, 2))

    return {
        "pose": by(CAMERA, camera_cov(found.cov, None, None)),
        "told": by(CAMERA, camera_cov(found.cov, found.cov_with_lens, LensPrior())),
        "found": by(found.camera, camera_cov(found.cov, found.cov_with_lens, None)),
    }


def _level(sights: Array, below_m: float) -> Array:
    return np.asarray(sights * (-below_m / sights[:, 2:]))
