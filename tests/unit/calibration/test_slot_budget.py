"""The error of a part in its slot as it is predicted, against draws of what errs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.hand_eye import se3
from calibration.slot.budget import Geometry, Sources, error_budget, quantile_radius
from cell.poses import Array, exp_xi, from_pose6

DRAWS = 20000
NONE = np.zeros((6, 6))
AT = Geometry(
    T_flange_camera=from_pose6([0.01, -0.08, 0.05, 0.02, -0.03, 0.1]),
    T_camera_slot=from_pose6([0.003, -0.004, 0.3, 0.01, 0.02, 0.3]),
    T_flange_part=from_pose6([0.001, 0.002, 0.26, 0.0, 0.01, 0.2]),
    T_slot_part=from_pose6([0.0, 0.0, 0.06, 0.0, 0.0, 0.0]),
)
SOURCES = Sources(
    camera={"hand-eye": np.diag([1e-4, 2e-4, 3e-4, 2e-4, 3e-4, 1e-4]) ** 2},
    part={"part in the gripper": np.diag([5e-5, 8e-5, 1e-4, 4e-4, 2e-4, 5e-4]) ** 2},
    detection={"detection": np.diag([2e-5, 3e-5, 3e-4, 5e-3, 4e-3, 1e-3]) ** 2},
    arm_look=np.eye(6)[:, :4],
    arm_insert=np.diag([1.0, -0.5, 0.3, 1.2, 1.0, 1.0])[:, :4],
    arm=np.diag([1e-4, 5e-5, 8e-5, 3e-4]) ** 2,
    repeat=np.diag([3e-5] * 3 + [1e-4] * 3) ** 2,
)


def drawn_errors(at: Geometry, sources: Sources, rng: np.random.Generator) -> Array:
    """(n, 2): where the part's front truly comes to be, across the slot, when all poses err."""

    def draw(*covs: Array) -> Array:
        return se3.exp(rng.multivariate_normal(np.zeros(6), np.sum(covs, axis=0), DRAWS))

    X, C, P, D = (
        T.as_matrix() for T in (at.T_flange_camera, at.T_camera_slot, at.T_flange_part, at.T_slot_part)
    )
    numbers = rng.multivariate_normal(np.zeros(len(sources.arm)), sources.arm, DRAWS)
    look = se3.exp(numbers @ sources.arm_look.T) @ draw(sources.repeat)
    insert = se3.exp(numbers @ sources.arm_insert.T) @ draw(sources.repeat)
    camera, part, slot = (draw(*kind.values()) for kind in (sources.camera, sources.part, sources.detection))
    T_slot = look @ X @ camera @ C @ slot
    T_part = X @ C @ D @ np.linalg.inv(P) @ insert @ P @ part
    return np.asarray((np.linalg.inv(T_slot) @ T_part)[:, :2, 3])


def test_the_prediction_is_what_draws_of_all_causes_give() -> None:
    subject = error_budget(AT, SOURCES)
    drawn = drawn_errors(AT, SOURCES, np.random.default_rng(1))
    assert subject.cov == pytest.approx(np.cov(drawn.T), rel=0.05, abs=0.02 * subject.cov.max())
    inside = np.mean(np.linalg.norm(drawn, axis=1) < subject.predicted_95)
    assert inside == pytest.approx(0.95, abs=0.006)


def test_an_arm_that_errs_alike_at_both_poses_does_no_harm() -> None:
    """A turn of the whole base: at either pose it moves the flange by the same motion of the base."""
    look = from_pose6([-0.6, -0.2, 0.6, 2.2, 2.2, 0.0])
    insert = look * AT.T_flange_camera * AT.T_camera_slot * AT.T_slot_part * AT.T_flange_part.inv()
    turn = np.array([0.0, 0.0, 0.0, 1.0, 0.5, 2.0])

    def in_flange(T: RigidTransform) -> Array:
        step = 1e-6
        moved = T.inv() * exp_xi(step * turn) * T
        return np.asarray(moved.as_exp_coords()[[3, 4, 5, 0, 1, 2]] / step)[:, None]

    alone = replace(
        SOURCES,
        camera={"hand-eye": NONE},
        part={"part in the gripper": NONE},
        detection={"detection": NONE},
        repeat=NONE,
        arm_look=in_flange(look),
        arm_insert=in_flange(insert),
        arm=np.array([[1e-6]]),
    )
    assert error_budget(AT, alone).predicted_95 < 1e-7


def test_each_cause_is_told_and_the_largest_first() -> None:
    told = error_budget(AT, SOURCES).told()
    causes = ["hand-eye", "arm model", "arm repeatability", "part in the gripper", "detection"]
    assert sorted(told) == sorted(causes)
    assert list(told.values()) == sorted(told.values(), reverse=True)


@pytest.mark.parametrize(
    ("cov", "radius"),
    [
        (np.eye(2), np.sqrt(5.991)),  # chi-square with 2 degrees of freedom
        (np.diag([1.0, 1e-12]), 1.95996),  # normal
        (np.zeros((2, 2)), 0.0),
    ],
)
def test_the_radius_is_that_of_known_distributions(cov: Array, radius: float) -> None:
    assert quantile_radius(cov) == pytest.approx(radius, rel=1e-3)
