"""How late the arm is on its set-points is learnt from where it is, and made up for."""

from collections.abc import Callable

import numpy as np
import pytest

from cell.devices import TrajectoryPiece
from cell.errors import CellError
from cell.following import MOST_LAG_S
from cell.poses import Array
from procedures.belt.motion.arm_following import ArmFollowing
from procedures.belt.motion.servo_lag import Lag
from tests.kit.motion_bench import OpenGuard

STEP_S = 0.02
SLOPE = np.array([0.4, -0.2, 0.0, 0.3, 0.0, 0.1])
Arm = Callable[[float, Array], Array]


def wanted(t: float) -> Array:
    """To and fro."""
    return SLOPE * np.sin(2.0 * t)


def piece(t: float) -> TrajectoryPiece:
    """The way from ``t`` on, to the third power."""
    s, c = np.sin(2.0 * t), np.cos(2.0 * t)
    rows = [s, 2.0 * c, -2.0 * s, -4.0 / 3.0 * c]
    return TrajectoryPiece(t, t + 0.15, np.array([row * SLOPE for row in rows]))


def anything(_: TrajectoryPiece) -> bool:
    return True


class LateArm:
    """Is on what it is sent ``delay`` s late, behind a low-pass of ``smooth`` s."""

    def __init__(self, delay: float, smooth: float) -> None:
        self._delay, self._smooth = delay, smooth
        self._sent: list[TrajectoryPiece] = []
        self._t, self.q = 0.0, wanted(0.0)

    def send(self, sent: TrajectoryPiece) -> None:
        self._sent.append(sent)

    def go(self, t: float) -> None:
        for at in np.arange(self._t + 0.001, t + 1e-9, 0.001):
            goal = self._goal(at - self._delay)
            keep = np.exp(-0.001 / self._smooth) if self._smooth > 0.0 else 0.0
            self.q = goal + keep * (self.q - goal)
        self._t = t

    def _goal(self, t: float) -> Array:
        now = next((p for p in reversed(self._sent) if p.t0 <= t), None)
        if now is None:
            return wanted(0.0)
        return (min(t, now.t1) - now.t0) ** np.arange(len(now.coefficients)) @ now.coefficients


def follow(subject: Lag, arm: LateArm, seconds: float) -> float:
    """Sends the way to the arm; returns the largest error of the last second, rad."""
    subject.begin(0.0, wanted(0.0))
    now, off = 0.0, []
    while now < seconds:
        arm.send(subject.ahead(piece(now + 0.012 + subject.delay_s), anything))
        now += STEP_S
        arm.go(now)
        subject.look(now, arm.q)
        if now > seconds - 1.0:
            off.append(float(np.max(np.abs(arm.q - wanted(now)))))
    return max(off)


@pytest.mark.parametrize(
    ("delay", "smooth"), [(0.006, 0.0), (0.056, 0.0), (0.21, 0.0), (0.004, 0.032), (0.004, 0.052)]
)
@pytest.mark.parametrize("expected", [0.0, 0.05])
def test_a_lag_of_any_kind_is_learnt_and_made_up_for(delay: float, smooth: float, expected: float) -> None:
    subject = Lag(expected)
    off = follow(subject, LateArm(delay, smooth), 8.0)
    assert subject.s == pytest.approx(delay + smooth, abs=0.002)
    assert off < 0.02 * 2.0 * float(np.max(SLOPE)) * 2.0  # 20 ms of its way would be that; it is far less
    assert off < 0.004


def test_an_arm_at_rest_tells_nothing_about_its_lag() -> None:
    subject = Lag(0.05)
    subject.begin(0.0, np.zeros(6))
    subject.ahead(TrajectoryPiece(0.0, 1.0, np.zeros((2, 6))), anything)
    subject.look(0.5, np.full(6, 0.01))
    assert subject.s == 0.05


def test_no_lag_longer_than_a_controller_can_cause_is_learnt() -> None:
    subject = Lag(0.05)
    follow(subject, LateArm(0.8, 0.0), 6.0)
    assert subject.s <= MOST_LAG_S


def test_set_points_that_the_guard_refuses_are_sent_without_making_up_for_the_low_pass() -> None:
    subject = Lag(0.05)
    follow(subject, LateArm(0.0, 0.052), 8.0)
    made_up, plain = subject.ahead(piece(9.0), anything), subject.ahead(piece(9.0), lambda sent: False)
    assert not np.allclose(made_up.coefficients, piece(9.0).coefficients)
    assert np.array_equal(plain.coefficients, piece(9.0).coefficients)
    assert plain.t0 == pytest.approx(9.0 - subject.s)


def looked(subject: ArmFollowing, off: list[float], step_s: float = 0.02, begin_s: float = 0.0) -> float:
    """Looks at a tool that is so far beside its set-points (m); returns the time of the last one."""
    for k, y in enumerate(off):
        subject.look(begin_s + step_s * k, np.zeros(3), np.array([0.0, y, 0.0]))
    return begin_s + step_s * (len(off) - 1)


def following() -> ArmFollowing:
    return ArmFollowing(0.05, limit_m=0.003, guard=OpenGuard())  # type: ignore[arg-type]


def test_a_tool_that_is_left_behind_for_a_moment_is_told_of_and_ends_nothing() -> None:
    """Set-points that were missing for 60 ms, at a belt of 0.2 m/s."""
    subject = following()
    looked(subject, [0.0] * 20 + [0.004, 0.008, 0.012, 0.006] + [0.0] * 20)
    assert subject.largest_m == pytest.approx(0.012)
    assert subject.rms_m == pytest.approx(np.sqrt(260e-6 / 44))
    assert "up to 12.0 mm from its set-points during a grip" in str(subject.left_behind)
    assert following().left_behind is None


@pytest.mark.parametrize(
    ("off", "step_s", "within_s"),
    [(0.03, 0.02, 0.22), (0.005, 0.02, 0.22), (0.005, 0.04, 0.24), (0.0033, 0.02, 0.4)],
)
def test_a_tool_that_stays_beside_its_set_points_ends_the_job(
    off: float, step_s: float, within_s: float
) -> None:
    subject = following()
    begin = looked(subject, [0.002] * 50, step_s)
    with pytest.raises(CellError, match="mm beside its set-points") as caught:
        looked(subject, [off] * 50, step_s, begin + step_s)
    assert caught.value.name == "ARM_NOT_FOLLOWING"
    assert (subject.looks - 50) * step_s <= within_s


def test_grips_that_are_all_short_add_up() -> None:
    """A held arm shows in the second or third; between grips nobody looks, and nothing is forgotten."""
    subject, begin = following(), 0.0
    with pytest.raises(CellError, match="mm beside its set-points"):
        for _ in range(3):
            begin = looked(subject, [0.01] * 5, begin_s=begin) + 3.0


def test_a_stamp_before_the_last_one_weighs_nothing() -> None:
    subject = following()
    last = looked(subject, [0.002] * 20)
    before = subject.lately_m
    subject.look(last - 1.0, np.zeros(3), np.array([0.0, 0.05, 0.0]))
    assert subject.lately_m == before


def test_a_tool_that_is_beside_them_in_a_third_of_the_time_is_told_of_and_ends_nothing() -> None:
    subject = following()
    looked(subject, [0.01, 0.0, 0.0] * 50)
    assert subject.rms_m == pytest.approx(0.01 / np.sqrt(3.0))
