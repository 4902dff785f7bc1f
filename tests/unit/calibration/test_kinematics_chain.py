"""The pieces of inverse kinematics that the arm models share."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.kinematics.chain import SerialChain, pose_gap
from calibration.kinematics.inverse import TOLERANCE, converge, distinct, nearest_turns
from calibration.kinematics.ur import UrArmModel
from cell.poses import Array

LIMITS = np.array([[-2, 2], [-2, 2], [-1, 1], [-2, 2], [-2, 2], [-2, 2]]) * np.pi
vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)
angles = st.lists(st.floats(-6.2, 6.2), min_size=6, max_size=6).map(np.array)


@settings(max_examples=200, deadline=None)
@given(vectors, st.one_of(st.floats(0, np.pi), st.sampled_from([0.0, 1e-9, np.pi - 1e-8, np.pi])))
def test_the_gap_between_two_poses_closes_it(axis: Array, angle: float) -> None:
    reached, goal = np.eye(4)[None], np.eye(4)[None].copy()
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    goal[0, :3, :3], goal[0, :3, 3] = turn.as_matrix(), [0.1, -0.2, 0.3]
    (gap,) = pose_gap(goal, reached)
    np.testing.assert_allclose(gap[:3], [0.1, -0.2, 0.3])
    assert (Rotation.from_rotvec(gap[3:]).inv() * turn).magnitude() < 1e-6


@given(angles, angles)
def test_the_nearest_turn_is_the_same_angle_within_limits_and_none_is_nearer(q: Array, near: Array) -> None:
    found = nearest_turns(q, near, LIMITS)
    assert found is not None
    np.testing.assert_allclose(np.sin((found - q) / 2), 0.0, atol=1e-9)
    assert np.all((found >= LIMITS[:, 0]) & (found <= LIMITS[:, 1]))
    for k in (-2, -1, 0, 1, 2):
        other = q + 2 * np.pi * k
        allowed = (other >= LIMITS[:, 0]) & (other <= LIMITS[:, 1])
        assert np.all(~allowed | (np.abs(found - near) <= np.abs(other - near) + 1e-9))


def test_an_angle_without_a_turn_in_its_limits_has_no_solution() -> None:
    tight = LIMITS.copy()
    tight[3] = [0.1, 0.2]
    assert nearest_turns(np.zeros(6), np.zeros(6), tight) is None


@pytest.mark.parametrize(("shift", "count"), [(2 * np.pi, 1), (1e-9, 1), (1e-3, 2)])
def test_solutions_that_differ_by_turns_are_one(shift: float, count: int) -> None:
    q = np.array([0.1, -1.2, 1.3, -0.4, 3.14159, -3.14159])
    assert len(distinct([q, q + shift * np.eye(6)[0]])) == count


@pytest.mark.parametrize(("off_rad", "looks"), [(0.02, 3), (1e-4, 2), (1e-7, 1)])
def test_a_last_step_that_is_known_to_reach_the_goal_is_not_looked_at(
    off_rad: float, looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = UrArmModel("ur10e").chain
    Q = np.array([0.1, -1.6, 1.5, -1.4, -1.5, 0.2]) + np.linspace(0.0, 0.2, 3)[:, None]
    goals, seen = chain.flange(Q), list[int]()
    frames = SerialChain.frames

    def watched(chain: SerialChain, Q: Array) -> Array:
        seen.append(len(Q))
        return frames(chain, Q)

    monkeypatch.setattr(SerialChain, "frames", watched)
    found, reached = converge(chain, goals, Q + off_rad * np.cos(np.arange(6.0)))
    assert len(seen) <= looks
    assert reached.all()
    assert np.abs(pose_gap(goals, chain.flange(found))).max() < TOLERANCE
