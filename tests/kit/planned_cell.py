"""Captures of an imperfect cell at poses that the product's planner chose, in a cell without obstacles."""

from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.adjustment.arm_accuracy import position_metric
from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.adjustment.prediction import PlannedViews, expected
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye.solution import Measurements
from calibration.planning import (
    ConePlan,
    ConeRequest,
    ConeShape,
    EyeInHand,
    PredictedUncertainty,
    plan_telling_cone,
)
from cell.poses import Array
from tests.kit.imperfect_cell import (
    ARM,
    CAMERA,
    FLANGE_R,
    FLANGE_T,
    MODEL,
    POINTS,
    PX,
    X_NOMINAL,
    World,
    board_somewhere,
    gathered,
    seen_from,
)

HALF_ANGLE_RAD, DISTANCE_M = 0.44, 0.5
KEPT = 0.9  # of the poses; a board where fewer are reached stands elsewhere
NOISE = {"sigma_px": PX, "sigma_flange_t": FLANGE_T, "sigma_flange_r": FLANGE_R}


@dataclass(frozen=True)
class Placed:
    """A plan around the board at ``T_base_target``."""

    T_base_target: RigidTransform
    plan: ConePlan


def planned(
    rng: np.random.Generator, placements: int, poses: int, lens: LensPrior, board: TargetPrior
) -> list[Placed]:
    """Placements at which hardly a pose is lost, for a lens and a board that are so well known."""
    error = partial(expected_error, placements=placements, lens=lens, board=board)
    placed: list[Placed] = []
    while len(placed) < placements:
        W, _ = board_somewhere(rng)
        down = Rotation.from_rotvec([np.pi, 0.0, 0.0])
        C = RigidTransform.from_components([0, 0, DISTANCE_M] - down.apply(POINTS.mean(axis=0)), down)
        flange = W * C.inv() * X_NOMINAL.inv()
        if not (starts := ARM.inverse_all(flange)):
            continue
        request = ConeRequest(
            mounting=EyeInHand.from_view(X_NOMINAL, flange, C),
            shape=ConeShape(poses, HALF_ANGLE_RAD, DISTANCE_M),
            target_points=POINTS,
            intrinsics=CAMERA,
            T_camera_target=C,
            q_start=starts[0],
        )
        plan = plan_telling_cone(request, ARM, lambda _from, _to: None, error)
        if len(plan.poses) >= KEPT * poses:
            placed.append(Placed(W, plan))
    return placed


def expected_error(plan: ConePlan, placements: int, lens: LensPrior, board: TargetPrior) -> float:
    """As the job has it: of a point before the camera, by the corrected arm anywhere, m RMS."""
    views = PlannedViews(
        np.stack([p.T_base_flange.as_matrix() for p in plan.poses]),
        np.stack([p.T_camera_target.as_matrix() for p in plan.poses]),
        X_NOMINAL.as_matrix(),
        POINTS,
    )
    arm = ArmKnown(MODEL, np.stack([p.q for p in plan.poses]), ARM.joint_limits, scale_free=False)
    found = expected("eye-in-hand", views, CAMERA, NOISE, arm, lens, board, placements)
    sure = PredictedUncertainty(found.cov)
    left = np.sqrt(np.sum(_metric() * found.cov_arm))
    return float(np.linalg.norm([sure.sigma_t_m, DISTANCE_M * sure.sigma_r_rad, left]))


@cache
def _metric() -> Array:
    return position_metric(ArmKnown(MODEL, np.zeros((1, 6)), ARM.joint_limits, scale_free=False))


def capture_planned(
    rng: np.random.Generator, cell: World, placed: list[Placed]
) -> tuple[Measurements, Array]:
    """Views and joints at the planned poses; the flange as the controller has it, from the nominal arm."""
    return gathered(
        [
            [
                seen_from(rng, cell, p.q, at.T_base_target, p.T_camera_target.as_matrix())
                for p in at.plan.poses
            ]
            for at in placed
        ]
    )
