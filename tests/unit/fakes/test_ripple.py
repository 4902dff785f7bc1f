"""While it follows set-points the twin's arm is beside them by waves of its gears, as large as it is fast."""

import numpy as np
import pytest

from cell.errors import CellError
from fakes.object.stream_time import StreamTime
from fakes.world.arm.joint_speeds import fastest_joints
from fakes.world.arm.ripple import Ripple, Rippled
from fakes.world.arm.segments import Polynomial
from fakes.world.arm.servo import Servo
from fakes.world.arm.smoothed import Smoothed
from fakes.world.arm.sweep import fastest
from fakes.world.arm.track import Track
from fakes.world.arm.truth import ArmTruth, Lag, ServoTruth
from fakes.world.scenario import Scenario, shipped_scenarios

SIZE_S, SEED = 0.00043, 3
PERIOD_S, LATE_S = 0.002, 0.05
CUBIC = np.array([[0.0] * 6, [0.0] * 6, [0.6, -0.3, 0.5, 0.0, 1.0, 0.1], [-0.1] * 6])


def ripple() -> Ripple:
    made = Ripple.of(ServoTruth(lag="delay", ripple_s=SIZE_S), SEED)
    assert made is not None
    return made


def test_at_a_radian_a_second_the_arm_is_beside_its_way_by_as_much_as_was_measured_and_at_rest_on_it() -> (
    None
):
    subject, q = ripple(), np.linspace(0.0, 0.1, 1000)[:, None] * np.ones(6)
    assert np.max(np.abs(subject.deviation(q, np.ones(6)))) == pytest.approx(0.43e-3, rel=0.01)
    assert np.max(np.abs(subject.deviation(q, np.full(6, 0.1)))) == pytest.approx(0.043e-3, rel=0.01)
    assert not subject.deviation(q, np.zeros(6)).any()


@pytest.mark.parametrize("lag", ["delay", "low-pass"])
def test_its_speeds_are_those_of_its_way_and_it_comes_to_rest_where_it_was_sent(lag: Lag) -> None:
    sent = Polynomial(1.0, 1.4, 1.0, CUBIC)
    way = sent if lag == "delay" else Smoothed(sent, LATE_S, np.zeros(6))
    subject, bound = Rippled(way, ripple()), fastest(Rippled(way, ripple()))
    for t in (1.1, 1.25, 1.39, 1.41, 1.45):
        slope = (subject.at(t + 1e-6)[0] - subject.at(t - 1e-6)[0]) / 2e-6
        assert subject.at(t)[1] == pytest.approx(slope, abs=1e-5)
        assert np.all(np.abs(subject.at(t)[1]) <= bound)
    assert not np.allclose(subject.at(1.39)[0], way.at(1.39)[0], atol=1e-5)
    assert np.array_equal(subject.at(subject.t_end)[0], way.at(way.t_end)[0])


def test_both_twins_deviate_alike() -> None:
    truth, sent = ServoTruth(lag="delay", ripple_s=SIZE_S), Polynomial(0.0, 1.0, 0.0, CUBIC)
    track = Track(0.0, np.zeros(6))
    stream = StreamTime(track, ArmTruth(model="ur10e", q_start=[0.0] * 6, servo=truth), SEED)
    servo, off = Servo(truth, fastest_joints("ur10e"), ripple()), []
    for k in range(500):
        t = k * PERIOD_S
        if k % 10 == 0:
            stream.follow(Polynomial(t, t + 0.1, 0.0, CUBIC), LATE_S)
        q = servo.step(t, lambda: np.zeros(6), sent.at(t)[0], LATE_S, PERIOD_S, 1.0)
        # The one goes by the speed at a time, the other by that over a cycle before it.
        assert track.at(t + PERIOD_S)[0] == pytest.approx(q, abs=5e-6)
        off.append(q - sent.at(max(t + PERIOD_S - LATE_S, 0.0))[0])
    assert 0.6e-3 < np.max(np.abs(off)) < 0.9e-3


def test_every_shipped_arm_ripples_and_an_ideal_one_does_not() -> None:
    for name in shipped_scenarios():
        assert Scenario.load(name).world.arm.servo.ripple_s == SIZE_S, name
        assert Scenario.load(f"{name}:ideal").world.arm.servo.ripple_s == 0.0, name


def test_an_arm_that_is_on_its_set_points_at_once_cannot_ripple() -> None:
    with pytest.raises((ValueError, CellError), match="ripple_s needs a lag"):
        ServoTruth(ripple_s=SIZE_S)
