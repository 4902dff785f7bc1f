"""Set-points from polynomials, and the ramp when they are not renewed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.ur.following import End, Follower, Piece

HORIZON, DECEL, SETTLE = 0.1, 8.0, 0.09
_COEFFICIENT = st.floats(-3, 3)
_ROWS = st.lists(st.lists(_COEFFICIENT, min_size=6, max_size=6), min_size=1, max_size=6)


@pytest.fixture
def subject() -> Follower:
    return Follower(HORIZON, DECEL, SETTLE, GAP)


def led_to(subject: Follower, t: float, beat: float | None = None, since: float = 0.0) -> list[float]:
    """The set-point at ``t`` of a process that was never late; the beat is in time unless it is given."""
    q = None
    for s in (*np.arange(since, t, 0.002), t):
        q = subject.setpoint(float(s), beat=float(s) if beat is None else min(beat, float(s)))
    assert q is not None
    return q


def constant_speed(t0: float, t1: float, speed: float, start: float = 0.0) -> Piece:
    return Piece(t0, t1, [[start] * 6, [speed] * 6])


@given(_ROWS, st.floats(0, 2))
def test_a_piece_is_its_polynomial_and_the_derivative(rows: list[list[float]], span: float) -> None:
    q, qd = Piece(10.0, 20.0, rows).at(10.0 + span)
    expected = np.polynomial.Polynomial
    for joint in range(6):
        polynomial = expected([row[joint] for row in rows])
        span_seen = (10.0 + span) - 10.0
        assert q[joint] == pytest.approx(polynomial(span_seen), rel=1e-9, abs=1e-9)
        assert qd[joint] == pytest.approx(polynomial.deriv()(span_seen), rel=1e-9, abs=1e-9)


def test_nothing_is_commanded_before_the_first_piece_begins(subject: Follower) -> None:
    subject.add(constant_speed(1.0, 2.0, 0.1))
    assert subject.setpoint(0.99, beat=0.99) is None
    assert subject.setpoint(1.0, beat=1.0) == [0.0] * 6


def test_a_finished_trajectory_ends_as_done_after_settling(subject: Follower) -> None:
    subject.add(Piece(0.0, 1.0, [[0.5] * 6]))
    subject.finish()
    assert led_to(subject, 1.002) == [0.5] * 6
    assert subject.ended(1.05, beat=1.0) is None
    assert subject.ended(1.0 + SETTLE, beat=1.0) is End.DONE


def test_a_piece_that_is_not_renewed_ends_in_a_ramp_to_rest(subject: Follower) -> None:
    subject.add(constant_speed(0.0, 0.1, 0.8))
    t = np.arange(0.0, 0.5, 0.002)
    q = np.array([subject.setpoint(float(s), beat=float(s)) for s in t])[:, 0]
    v = np.diff(q) / 0.002
    assert v[:40] == pytest.approx(0.8)
    assert v[-50:] == pytest.approx(0.0, abs=1e-9)
    assert np.min(np.diff(v)) / 0.002 > -DECEL * 1.01
    assert q[-1] == pytest.approx(0.08 + 0.8**2 / (2 * DECEL))
    assert subject.ended(0.5, beat=0.5) is End.NOT_RENEWED


def test_a_late_beat_ends_a_long_piece_within_the_horizon(subject: Follower) -> None:
    subject.add(constant_speed(0.0, 5.0, 0.4))
    assert led_to(subject, 0.3, beat=0.25) == pytest.approx([0.12] * 6)
    ramped = led_to(subject, 1.0, beat=0.25, since=0.3)
    assert ramped == pytest.approx([0.4 * 0.35 + 0.4**2 / (2 * DECEL)] * 6)
    assert subject.ended(1.0, beat=0.25) is End.NOT_RENEWED


def test_a_beat_that_comes_back_does_not_restart_the_motion(subject: Follower) -> None:
    subject.add(constant_speed(0.0, 5.0, 0.4))
    led_to(subject, 0.2, beat=0.0)
    rest = led_to(subject, 2.0, beat=0.0, since=0.2)
    assert led_to(subject, 2.5, since=2.0) == rest


def test_a_new_piece_replaces_the_plan_from_its_start(subject: Follower) -> None:
    subject.add(Piece(0.0, 1.0, [[0.0] * 6]))
    subject.add(Piece(0.5, 1.5, [[0.3] * 6]))
    assert led_to(subject, 0.4) == [0.0] * 6
    assert led_to(subject, 0.6, since=0.4) == [0.3] * 6


def test_a_stop_ramps_at_once_with_all_joints_together(subject: Follower) -> None:
    subject.add(Piece(0.0, 5.0, [[0.0] * 6, [0.8, 0.4, 0.0, 0.0, 0.0, -0.8]]))
    led_to(subject, 0.1)
    subject.stop()
    before = np.array(subject.setpoint(0.102, beat=0.1))
    after = np.array(led_to(subject, 5.0, beat=0.1, since=0.102))
    travel = after - before
    assert travel[1] == pytest.approx(travel[0] / 2)
    assert travel[5] == pytest.approx(-travel[0])
    assert subject.ended(5.0, beat=0.1) is End.STOPPED


def test_no_piece_and_no_beat_ends_it_too(subject: Follower) -> None:
    assert subject.ended(0.05, beat=0.0) is None
    assert subject.ended(0.11, beat=0.0) is End.NOT_RENEWED


@given(st.floats(0.01, 0.4), st.floats(-3, 3))
def test_set_points_never_jump_when_following_ends(cut: float, speed: float) -> None:
    subject = Follower(HORIZON, DECEL, SETTLE, GAP)
    subject.add(constant_speed(0.0, cut, speed))
    t = np.arange(0.0, 1.2, 0.002)
    q = np.array([subject.setpoint(float(s), beat=float(s)) for s in t])[:, 0]
    assert np.max(np.abs(np.diff(q))) <= abs(speed) * 0.002 * (1 + 1e-9) + 1e-12


GAP = 0.05


@given(
    st.floats(0.0, 0.9), st.floats(0.06, 3.0), st.booleans(), st.sampled_from(["nothing", "stop", "finish"])
)
def test_after_a_time_without_set_points_the_latest_one_is_held(
    at: float, lasts: float, beaten: bool, meanwhile: str
) -> None:
    """Where this process got no core the arm came to rest; no set-point leaps to where it would be by now."""
    subject = Follower(HORIZON, DECEL, SETTLE, GAP)
    subject.add(constant_speed(0.0, 0.5, 2.0))
    q = led_to(subject, at)
    if meanwhile != "nothing":
        getattr(subject, meanwhile)()
    back = at + lasts
    subject.add(constant_speed(0.4, back + 5.0, 2.0, start=0.8))
    beat = back if beaten else at
    assert led_to(subject, back + 1.0, beat=beat, since=back) == q
    if at < 0.5:
        wanted = End.STOPPED if meanwhile == "stop" else End.NOT_RENEWED
        assert subject.ended(back + 1.0, beat=beat) is wanted


def test_a_first_set_point_that_is_late_does_not_move_the_arm() -> None:
    subject = Follower(HORIZON, DECEL, SETTLE, GAP)
    subject.add(constant_speed(1.0, 2.0, 2.0, start=0.3))
    assert subject.broken_off is None
    assert led_to(subject, 2.0, since=1.2) == [0.3] * 6
    assert subject.broken_off is End.NOT_RENEWED
    assert subject.ended(2.0, beat=2.0) is End.NOT_RENEWED


def test_a_pause_at_the_end_of_a_trajectory_is_none_to_it() -> None:
    subject = Follower(HORIZON, DECEL, SETTLE, GAP)
    subject.add(Piece(0.0, 1.0, [[0.5] * 6]))
    subject.finish()
    led_to(subject, 1.01)
    assert led_to(subject, 2.0, since=1.5) == [0.5] * 6
    assert subject.broken_off is None
    assert subject.ended(2.0, beat=2.0) is End.DONE
