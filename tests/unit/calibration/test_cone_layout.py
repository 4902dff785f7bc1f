"""Which cone tells most: chosen by the adjustment's information, at the price of few poses."""

from functools import cache

import numpy as np

from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.adjustment.prediction import PlannedViews, expected
from calibration.adjustment.unknowns import ArmKnown
from calibration.kinematics.families import arm_spec
from calibration.planning import ConePlan, ConeShape, PredictedUncertainty, plan_cone, plan_telling_cone
from cell.formats.robot import parse_robot
from cell.poses import Array
from tests.unit.calibration.test_cone_plan import (
    CAMERA,
    PLACES,
    X_NOMINAL,
    assert_sound,
    board_points,
    make_guard,
    request,
)

NOISE = {"sigma_px": 0.15, "sigma_flange_t": 3e-5, "sigma_flange_r": 5e-5}
MODEL = arm_spec(parse_robot({"model": "ur10e"}, "robot"), "robot").arm


def error95(plan: ConePlan) -> float:
    """Of three placements like this one, with an arm, a lens and a board that nobody measured."""
    views = PlannedViews(
        np.stack([p.T_base_flange.as_matrix() for p in plan.poses]),
        np.stack([p.T_camera_target.as_matrix() for p in plan.poses]),
        X_NOMINAL.as_matrix(),
        board_points(),
    )
    Q = np.stack([p.q for p in plan.poses])
    arm = ArmKnown(MODEL, Q, np.tile([-np.pi, np.pi], (6, 1)), scale_free=False)
    found = expected("eye-in-hand", views, CAMERA, NOISE, arm, LensPrior(), TargetPrior(), 3)
    return PredictedUncertainty(found.cov).error95_t_m


@cache
def both() -> tuple[ConePlan, ConePlan]:
    """The plain cone and the one that tells more."""
    guard, wanted = make_guard(), request()
    plain = plan_cone(wanted, guard.model, guard.check_path_joints)
    return plain, plan_telling_cone(wanted, guard.model, guard.check_path_joints, error95)


def distances(plan: ConePlan) -> set[float]:
    centre = board_points().mean(axis=0)
    return {round(float(np.linalg.norm(p.T_camera_target.apply(centre))), 3) for p in plan.poses}


def test_the_plan_has_a_second_distance_and_halves_the_error() -> None:
    plain, subject = both()
    assert distances(plain) == {0.5}
    assert len(distances(subject)) == 2
    assert len(subject.poses) == len(plain.poses)
    assert error95(subject) < 0.5 * error95(plain)


def test_the_plan_is_as_free_as_any_other() -> None:
    wanted = request()
    assert_sound(both()[1], make_guard(), wanted.mounting)


def test_a_distance_that_is_given_is_kept() -> None:
    guard = make_guard()
    wanted = request(shape=ConeShape(12, 0.44, 0.5, second_distance_m=0.42))
    plan = plan_telling_cone(wanted, guard.model, guard.check_path_joints, error95)
    assert distances(plan) == {0.42, 0.5}


def test_a_change_costs_one_pose_in_ten_at_most_and_tells_more_for_it() -> None:
    """A box leaves half of the ring; what is changed may lose a few of the rest."""
    box = {"name": "post", "min": [-0.9, -0.35, 0.45], "max": [-0.75, -0.15, 1.2]}
    guard, wanted = make_guard(box), request(PLACES[1])
    plain = plan_cone(wanted, guard.model, guard.check_path_joints)
    asked: list[tuple[bytes, bytes]] = []

    def check(q_from: Array, q_to: Array) -> None:
        asked.append((q_from.tobytes(), q_to.tobytes()))
        guard.check_path_joints(q_from, q_to)

    subject = plan_telling_cone(wanted, guard.model, check, error95)
    assert len(set(asked)) == len(asked), "laps have most of their ways in common, which are judged once"
    assert 3 <= len(plain.poses) < 20, "the box is in the way"
    assert len(subject.poses) >= 0.9 * len(plain.poses)
    assert error95(subject) <= error95(plain)
    assert_sound(subject, guard, wanted.mounting)


def test_the_second_lap_is_on_another_branch_when_it_is_asked_for() -> None:
    guard = make_guard()
    shape = ConeShape(12, 0.44, 0.5, 0.6, laps=2, roll_rad=0.5 * np.pi, other_branch=True)
    plan = plan_cone(request(shape=shape), guard.model, guard.check_path_joints)
    signs = {(p.q[2] > 0.0, p.q[4] > 0.0) for p in plan.poses}
    assert len(signs) > 1
    assert_sound(plan, guard, request().mounting)
