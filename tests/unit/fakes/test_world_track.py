"""The track: joints as a function of time, whatever is commanded when."""

import pickle
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.poses import from_pose6, log_xi
from fakes.world.arm.kinematics import UnreachableError, chain
from fakes.world.arm.segments import Polynomial
from fakes.world.arm.track import Track

CHAIN = chain("ur10e")
Q0 = np.array([0.1, -1.2, 1.3, -1.0, -1.5, 0.3])
TOOL = from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0])


@pytest.fixture
def subject() -> Track:
    return Track(0.0, Q0)


def assert_speed_is_the_derivative(track: Track, t0: float, t1: float) -> None:
    h = 1e-6
    for t in np.linspace(t0 + h, t1 - h, 301):
        slope = (track.at(t + h)[0] - track.at(t - h)[0]) / (2 * h)
        assert np.allclose(slope, track.at(t)[1], atol=2e-4), t


def test_it_stands_still_before_and_after_everything(subject: Track) -> None:
    end = subject.start_joint_move(5.0, Q0 + 0.5, 1.0, 2.0)
    for t in (-100.0, 0.0, 4.999, end, end + 1e6):
        assert not np.any(subject.at(t)[1])
    assert np.array_equal(subject.at(-100.0)[0], Q0)
    assert np.array_equal(subject.at(end + 1e6)[0], Q0 + 0.5)


def test_the_joint_with_the_longest_way_sets_the_time_and_all_arrive_together(subject: Track) -> None:
    change = np.array([1.0, -0.5, 0.25, 0.0, 0.1, -0.2])
    end = subject.start_joint_move(1.0, Q0 + change, v=0.8, a=2.0)
    # The time of a trapezoid is way over speed plus speed over acceleration.
    assert end == pytest.approx(1.0 + 1.0 / 0.8 + 0.8 / 2.0)
    q, qd = subject.at(1.0 + (end - 1.0) / 2)
    assert np.allclose(q, Q0 + change / 2)
    assert np.allclose(qd, 0.8 * change)
    assert_speed_is_the_derivative(subject, 1.0, end)


def test_a_short_move_is_a_triangle(subject: Track) -> None:
    end = subject.start_joint_move(0.0, Q0 + 0.02, v=5.0, a=2.0)
    assert end == pytest.approx(2 * np.sqrt(0.02 / 2.0))


def test_a_linear_move_stays_on_the_line_at_the_speed_asked(subject: Track) -> None:
    start = CHAIN.forward(Q0) * TOOL
    goal = start * from_pose6([0.1, 0.05, -0.12, 0.2, -0.3, 0.1])
    end = subject.start_linear_move(1.0, CHAIN, goal, TOOL, v=0.25, a=0.5)
    way = goal.translation - start.translation
    length = float(np.linalg.norm(way))
    assert end == pytest.approx(1.0 + length / 0.25 + 0.25 / 0.5)
    tips = np.array(
        [(CHAIN.forward(subject.at(t)[0]) * TOOL).translation for t in np.linspace(1.0, end, 200)]
    )
    off_line = np.linalg.norm(np.cross(tips - start.translation, way / length), axis=1)
    assert np.max(off_line) < 1e-7
    assert np.max(np.abs(log_xi(goal.inv() * CHAIN.forward(subject.at(end)[0]) * TOOL))) < 1e-9
    q, qd = subject.at((1.0 + end) / 2)
    tip_speed = CHAIN.jacobian(q, TOOL.translation)[:3] @ qd
    assert np.linalg.norm(tip_speed) == pytest.approx(0.25, rel=1e-4)
    assert_speed_is_the_derivative(subject, 1.0, end)


def test_a_turn_on_the_spot_takes_time_too(subject: Track) -> None:
    goal = CHAIN.forward(Q0) * TOOL * from_pose6([0, 0, 0, 0, 0, 1.0])
    end = subject.start_linear_move(0.0, CHAIN, goal, TOOL, v=0.25, a=1.0)
    assert end == pytest.approx(0.25 / 0.25 + 0.25 / 1.0)


def test_an_unreachable_line_moves_nothing(subject: Track) -> None:
    with pytest.raises(UnreachableError):
        subject.start_linear_move(0.0, CHAIN, from_pose6([3.0, 0, 0, 0, 0, 0]), TOOL, 0.25, 0.5)
    assert subject.end_time == 0.0


def test_a_stop_on_the_line_stays_on_it(subject: Track) -> None:
    start = CHAIN.forward(Q0) * TOOL
    goal = start * from_pose6([0.0, 0.0, -0.2, 0.0, 0.0, 0.0])
    subject.start_linear_move(0.0, CHAIN, goal, TOOL, 0.25, 0.5)
    end = subject.stop_linear(0.6, decel=1.0)
    assert end == pytest.approx(0.6 + 0.25 / 1.0)
    tip = (CHAIN.forward(subject.at(end)[0]) * TOOL).translation
    way = goal.translation - start.translation
    gone = (tip - start.translation) @ way / np.linalg.norm(way)
    assert gone == pytest.approx(0.25 * 0.6 - 0.25**2 / (2 * 0.5) + 0.25**2 / 2.0, abs=1e-6)
    assert np.linalg.norm(np.cross(tip - start.translation, way)) < 1e-7
    assert_speed_is_the_derivative(subject, 0.0, end)


@pytest.mark.parametrize("t", [0.05, 0.3, 0.5, 0.65])
def test_a_controller_that_halts_a_joint_move_stays_on_its_way(subject: Track, t: float) -> None:
    goal = Q0 + np.array([1.0, -0.5, 0.2, 0.0, 0.0, 0.1])
    assert subject.start_joint_move(0.0, goal, 2.0, 10.0) == pytest.approx(0.7)
    end = subject.halt(t, decel=6.0)
    share = (subject.at(end)[0] - Q0)[:3] / (goal - Q0)[:3]
    assert share == pytest.approx(share[0])
    assert subject.at(t)[0][0] < subject.at(end)[0][0] <= goal[0] + 1e-9
    assert_speed_is_the_derivative(subject, 0.0, end)


def test_a_new_move_while_moving_brakes_first(subject: Track) -> None:
    subject.start_joint_move(0.0, Q0 + 1.0, 1.0, 2.0)
    end = subject.start_joint_move(0.7, Q0, 1.0, 2.0)
    assert np.allclose(subject.at(end)[0], Q0)
    assert_speed_is_the_derivative(subject, 0.0, end)


def test_constant_joint_speed_lasts_until_it_is_stopped(subject: Track) -> None:
    subject.speed_joints(0.0, [0.2, 0, 0, 0, 0, -0.4], a=2.0)
    assert subject.end_time == np.inf
    assert np.allclose(subject.at(50.0)[1], [0.2, 0, 0, 0, 0, -0.4])
    assert subject.is_moving(50.0)
    end = subject.stop_joint(50.0, decel=4.0)
    assert end == pytest.approx(50.1)
    assert not np.any(subject.at(end)[1])
    assert_speed_is_the_derivative(subject, 0.0, 1.0)
    assert_speed_is_the_derivative(subject, 49.5, end)


def test_servo_set_points_are_followed_and_the_arm_brakes_when_they_end(subject: Track) -> None:
    def wave(t: float) -> np.ndarray:
        return Q0 + 0.1 * (1 - np.cos(2 * t)) * np.ones(6)

    dt = 0.008
    for k in range(200):
        subject.servo(k * dt, wave((k + 1) * dt), dt)
    for t in np.linspace(0.3, 1.5, 50):
        assert np.max(np.abs(subject.at(t)[0] - wave(t))) < 1e-4
        assert np.max(np.abs(subject.at(t)[1] - 0.2 * np.sin(2 * t))) < 0.01
    last = 200 * dt
    assert last < subject.end_time < last + 0.1
    assert not np.any(subject.at(subject.end_time)[1])


def test_a_distant_servo_set_point_is_not_jumped_to(subject: Track) -> None:
    subject.servo(0.0, Q0 + 1.0, 0.002)
    speeds = [np.max(np.abs(subject.at(t)[1])) for t in np.linspace(0, 1.0, 500)]
    assert max(speeds) < 6.0
    assert np.allclose(subject.at(subject.end_time)[0], Q0 + 1.0, atol=0.05)


def test_polynomials_are_followed_exactly(subject: Track) -> None:
    c = np.array([Q0, 0 * Q0, np.full(6, 0.3)])
    subject.follow(Polynomial(1.0, 2.0, 1.0, c))
    assert np.allclose(subject.at(1.5)[0], Q0 + 0.3 * 0.25)
    assert np.allclose(subject.at(2.0)[1], 0.6)
    assert subject.end_time == pytest.approx(2.0 + 0.6 / 8.0)
    assert_speed_is_the_derivative(subject, 1.0, subject.end_time)


def test_history_is_kept_for_at_least_five_seconds(subject: Track) -> None:
    for k in range(400):
        subject.start_joint_move(k * 0.1, Q0 + 0.01 * (k % 2), 1.0, 50.0)
    reference = Track(0.0, Q0, keep_s=1e9)
    for k in range(400):
        reference.start_joint_move(k * 0.1, Q0 + 0.01 * (k % 2), 1.0, 50.0)
    for t in np.linspace(34.9, 40.0, 100):
        assert np.array_equal(subject.at(t)[0], reference.at(t)[0])
    assert len(subject.snapshot()) < 0.5 * len(reference.snapshot())


Command = Callable[[Track, float], float]
COMMANDS: list[Command] = [
    lambda track, t: track.start_joint_move(t, Q0 + 0.2, 1.0, 3.0),
    lambda track, t: track.start_linear_move(
        t, CHAIN, CHAIN.forward(Q0) * TOOL * from_pose6([0.03, 0, -0.03, 0, 0, 0.1]), TOOL, 0.2, 1.0
    ),
    lambda track, t: track.stop_joint(t, 6.0),
    lambda track, t: track.stop_linear(t, 2.0),
    lambda track, t: track.speed_joints(t, np.full(6, 0.1), 2.0),
    lambda track, t: track.servo(t, track.at(t)[0] + 0.001, 0.008),
]


@given(st.lists(st.tuples(st.integers(0, len(COMMANDS) - 1), st.floats(0.001, 0.5)), max_size=6))
@settings(max_examples=25, deadline=None)
def test_joints_never_jump_and_a_mirror_in_another_process_is_equal(
    commands: list[tuple[int, float]],
) -> None:
    subject, mirror = Track(0.0, Q0), Track(0.0, Q0)
    subject.listeners.append(lambda segment: mirror.append(pickle.loads(pickle.dumps(segment))))
    t = 0.0
    for which, wait in commands:
        COMMANDS[which](subject, t)
        t += wait
    times = np.arange(0.0, t + 2.0, 0.01)
    joints = [subject.at(s)[0] for s in times]
    assert all(np.max(np.abs(b - a)) < 0.06 for a, b in pairwise(joints))
    assert all(np.array_equal(a, mirror.at(s)[0]) for s, a in zip(times, joints, strict=True))


def test_a_late_mirror_starts_from_a_snapshot(subject: Track) -> None:
    subject.start_joint_move(0.0, Q0 + 0.3, 1.0, 2.0)
    mirror = Track(0.0, np.zeros(6))
    mirror.load(pickle.loads(pickle.dumps(subject.snapshot())))
    assert np.array_equal(mirror.at(0.3)[0], subject.at(0.3)[0])


@pytest.mark.parametrize(("v", "a"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 1.0)])
def test_speeds_and_accelerations_must_be_positive(subject: Track, v: float, a: float) -> None:
    with pytest.raises(ValueError, match="positive speed"):
        subject.start_joint_move(0.0, Q0 + 1, v, a)
