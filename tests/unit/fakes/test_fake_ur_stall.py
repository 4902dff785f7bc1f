"""A twin whose process stood still does not blame the client for what it has not read yet."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from fakes.ur.arm import Arm, Tool
from fakes.ur.inputs import InputOutput, Inputs
from fakes.world.arm.controller_limits import ControllerLimitsTruth
from fakes.world.arm.kinematics import chain
from fakes.world.arm.segments import PathMove
from fakes.world.arm.sweep import joints
from fakes.world.arm.track import Track


@pytest.fixture
def subject() -> Inputs:
    inputs = Inputs({}, InputOutput())
    inputs.arm_watchdog("input_int_register_0", 10.0, 0.0)
    return inputs


def test_a_client_that_is_silent_for_the_period_lets_the_watchdog_expire(subject: Inputs) -> None:
    assert not subject.watchdog_expired(0.09)
    assert subject.watchdog_expired(0.11)


def test_the_time_that_the_twin_itself_stood_still_does_not_count(subject: Inputs) -> None:
    subject.excuse(0.5, 0.52)
    assert not subject.watchdog_expired(0.55)
    assert subject.watchdog_expired(0.61)


def test_a_kick_that_was_read_right_after_it_does_not_hide_that_no_other_follows(subject: Inputs) -> None:
    subject.write({"input_int_register_0": 1}, 1.5)
    subject.excuse(1.5, 1.501)
    assert not subject.watchdog_expired(1.59)
    assert subject.watchdog_expired(1.61)


@pytest.fixture
def arm() -> Arm:
    """At rest at zero."""
    track = Track(0.0, np.zeros(6))
    return Arm(track, chain("ur10e"), Tool(), None, ControllerLimitsTruth().ranges())


def test_a_move_goes_on_from_where_it_was(arm: Arm) -> None:
    """A stop that the client sent in the meantime finds the arm where it had come to, and no farther."""
    steps = arm.move_joints([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 5.0)
    next(steps)
    arm.t = 0.4
    before, _ = arm.track.at(0.4)
    arm.stood_still(0.5, 0.9)
    arm.t = 0.9
    after, speeds = arm.track.at(0.9)
    assert after == pytest.approx(before)
    assert speeds[0] == pytest.approx(1.0)
    arm.t = 1.3  # without the pause it would have arrived at 1.2
    next(steps)
    arm.t = 1.75
    with pytest.raises(StopIteration):
        next(steps)
    assert arm.q[0] == pytest.approx(1.0)


def test_what_was_before_a_pause_stays_as_it_was(arm: Arm) -> None:
    """An input module has counted what the tool broke on that way."""
    next(arm.move_joints([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 5.0))
    times = [0.05, 0.3, 0.4]
    before = [arm.track.at(t)[0][0] for t in times]
    arm.stood_still(0.5, 0.9)
    arm.stood_still(0.2, 1.2)
    assert [arm.track.at(t)[0][0] for t in times] == before
    assert arm.track.at(0.7)[0][0] == arm.track.at(0.9)[0][0] == before[-1]
    assert arm.track.at(1.2)[0][0] == pytest.approx(arm.track.at(1.0)[0][0])
    assert arm.track.at(1.3)[0][0] == pytest.approx(arm.track.at(1.2)[0][0] + 0.1)


def test_a_straight_move_goes_on_on_its_path_and_the_beams_see_the_same(arm: Arm) -> None:
    """The beams look at many times in one call, and the camera's process gets a copy."""
    q0 = np.array([0.0, -1.5, 1.5, -1.57, -1.57, 0.0])
    track, believed = Track(0.0, q0), chain("ur10e")
    start = RigidTransform.from_matrix(believed.matrix(q0))
    goal = RigidTransform.from_translation([0.0, 0.0, 0.1]) * start
    track.start_linear_move(0.0, believed, goal, RigidTransform.identity(), 0.1, 1.0)
    before = track.at(0.4)[0]
    track.delay(0.9, 0.5)
    moved = track.segment_at(1.0)
    assert isinstance(moved, PathMove)
    assert track.at(0.9)[0] == pytest.approx(before, abs=1e-12)
    times = np.linspace(0.9, 1.7, 9)
    one_by_one = np.array([track.at(t)[0] for t in times])
    np.testing.assert_allclose(joints(moved, times), one_by_one, atol=1e-12)
    np.testing.assert_allclose(joints(pickle.loads(pickle.dumps(moved)), times), one_by_one, atol=1e-12)
    arrived = believed.matrix(track.at(track.end_time)[0])[:3, 3]
    np.testing.assert_allclose(arrived, goal.translation, atol=1e-6)


def test_the_arm_is_where_the_next_set_point_has_it(arm: Arm) -> None:
    """It is not driven there from where it was when the process stopped, faster than any joint turns."""
    arm.servo([0.002, 0, 0, 0, 0, 0], 0.002, 0.05, 500.0)
    arm.stood_still(0.5, 0.502)
    arm.t = 0.502
    arm.servo([0.4, 0, 0, 0, 0, 0], 0.002, 0.05, 500.0)
    q, qd = arm.track.at(0.51)
    assert q[0] == pytest.approx(0.4)
    assert np.abs(qd).max() == pytest.approx(0.0, abs=1e-9)
