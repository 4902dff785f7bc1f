"""The closed-form inverse of the published UR arms against an independent library, and by going forward."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.kinematics import UR_MODELS, DhDeltas, UrArmModel
from calibration.kinematics.ur_inverse import branches as subject
from cell.poses import Array
from tests.kit.ur_reference import independent_library, independent_poses

OPEN = [-1.3, 2.0, 1.7, -0.9, 1.4, -0.9]
angles = st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6).map(np.array)


def apart(a: Array, b: Array) -> Array:
    """Largest joint difference, full turns not counted, rad."""
    return np.asarray(np.max(np.abs((a - b + np.pi) % (2 * np.pi) - np.pi), axis=-1))


def miss(name: str, found: Array, goal: Array) -> Array:
    """(k,): the largest deviation of an entry of the pose (m, or of a direction)."""
    return np.asarray(np.abs(UrArmModel(name).forward_many(found).as_matrix() - goal).max(axis=(1, 2)))


@pytest.mark.parametrize("name", sorted(UR_MODELS))
def test_the_joints_of_every_stored_pose_of_an_independent_library_are_found(name: str) -> None:
    for q, T in zip(*independent_poses(name), strict=True):
        assert apart(subject(UR_MODELS[name], T), q).min() < 1e-9


@pytest.mark.parametrize("name", sorted(UR_MODELS))
def test_the_open_arm_has_eight_different_branches_and_each_reaches_the_pose(name: str) -> None:
    goal = UrArmModel(name).forward(np.array(OPEN)).as_matrix()
    found = subject(UR_MODELS[name], goal)
    assert len(found) == 8
    assert miss(name, found, goal).max() < 1e-12
    assert all(apart(np.delete(found, i, axis=0), q).min() > 0.1 for i, q in enumerate(found))


@pytest.mark.parametrize("name", sorted(UR_MODELS))
def test_the_branches_are_those_of_an_independent_library(name: str) -> None:
    inverse = getattr(independent_library(), name).inverse_kinematics
    for q in np.random.default_rng(5).uniform(-np.pi, np.pi, (60, 6)):
        goal = np.ascontiguousarray(UrArmModel(name).forward(q).as_matrix())
        found = subject(UR_MODELS[name], goal)
        found = found[miss(name, found, goal) < 1e-9]
        expected = np.array(inverse(goal)).reshape(-1, 6)
        assert len(found) == len(expected)
        assert all(apart(found, other).min() < 1e-6 for other in expected)


@settings(max_examples=100, deadline=None)
@given(angles, st.sampled_from(sorted(UR_MODELS)))
def test_a_pose_that_joints_reach_is_reached(q: Array, name: str) -> None:
    goal = UrArmModel(name).forward(q).as_matrix()
    found = subject(UR_MODELS[name], goal)
    assert 1 <= len(found) <= 8
    assert miss(name, found, goal).min() < 1e-9


@pytest.mark.parametrize("joint", [2, 4], ids=["elbow", "wrist"])
@pytest.mark.parametrize("bend", [1e-3, -1e-6, 1e-8])
def test_a_nearly_straight_elbow_or_wrist_is_solved_like_any_other(joint: int, bend: float) -> None:
    for q in np.random.default_rng(3).uniform(-np.pi, np.pi, (60, 6)):
        q[joint] = bend
        goal = UrArmModel("ur10e").forward(q).as_matrix()
        found = subject(UR_MODELS["ur10e"], goal)
        off = miss("ur10e", found, goal)
        assert off.min() < 1e-13
        assert apart(found[off < 1e-9], q).min() < 1e-5


@pytest.mark.parametrize("straight", [0.0, np.pi])
@pytest.mark.parametrize("name", ["ur3", "ur10e", "ur30"])
def test_a_straight_wrist_is_solved_wherever_any_joint_6_reaches(name: str, straight: float) -> None:
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (600, 6)):
        q[4] = straight
        goal = UrArmModel(name).forward(q).as_matrix()
        assert miss(name, subject(UR_MODELS[name], goal), goal).min() < 1e-9


def test_a_calibrated_arm_reaches_beyond_the_published_one() -> None:
    longer = DhDeltas(delta_a=np.array([0.0, -7e-4, -7e-4, 0.0, 0.0, 0.0]))
    arm, published = UrArmModel("ur5e", longer), UrArmModel("ur5e")
    q = np.array([0.3, -1.2, 0.02, -1.7, -1.5, 0.2])
    goal = arm.forward(q)
    assert miss("ur5e", subject(UR_MODELS["ur5e"], goal.as_matrix()), goal.as_matrix()).min() > 1e-4
    assert all(apart(b, q) > 0.1 for b in published.inverse_all(goal))
    assert min(float(apart(b, q)) for b in arm.inverse_all(goal)) < 1e-6


@pytest.mark.parametrize("point", [[0.0, 0.0, 0.6], [0.05, 0.02, 0.6], [9.0, 0.0, 0.0]])
def test_a_wrist_on_axis_1_or_out_of_reach_has_no_branch(point: list[float]) -> None:
    goal = np.eye(4)
    goal[:3, 3] = np.add(point, [0.0, 0.0, UR_MODELS["ur5e"].d6])
    assert len(subject(UR_MODELS["ur5e"], goal)) == 0


def test_one_pose_gives_the_same_joints_bit_by_bit_each_time() -> None:
    goal = UrArmModel("ur10e").forward(np.array(OPEN)).as_matrix()
    solve = partial(subject, UR_MODELS["ur10e"])
    np.testing.assert_array_equal(solve(goal), solve(goal.copy()))
