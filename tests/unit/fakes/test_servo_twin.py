"""The twin's arm follows set-points as a controller lets it: late, under the slider, within its joints."""

import numpy as np
import pytest

from cell.errors import CellError
from cell.poses import Array
from fakes.ur.build import controller_for
from fakes.world.arm.controller_limits import ControllerLimitsTruth
from fakes.world.arm.joint_speeds import fastest_joints
from fakes.world.arm.reported import Reported
from fakes.world.arm.segments import Polynomial
from fakes.world.arm.servo import Servo
from fakes.world.arm.smoothed import Smoothed
from fakes.world.arm.truth import JointErrorsTruth, Lag, Links, ReportedTruth, ServoTruth
from fakes.world.camera.truth import PrintTruth, ToldTruth
from fakes.world.scenario import Scenario, shipped_scenarios
from fakes.world.world import World
from tests.kit.ideal_world import ideal_text, shipped_text

PERIOD_S, LATE_S = 0.002, 0.05
RATE = np.array([0.2, -0.3, 0.5, 0.0, 1.0, 0.1])


def driven(lag: Lag, rate: Array, seconds: float, fraction: float = 1.0) -> tuple[Servo, list[Array]]:
    """The arm, cycle after cycle, on set-points that run at ``rate`` (rad/s) from rest."""
    subject, q = Servo(ServoTruth(lag=lag), fastest_joints("ur10e")), [np.zeros(6)]
    for k in range(round(seconds / PERIOD_S)):
        t = k * PERIOD_S
        q.append(subject.step(t, q[-1].copy, rate * t, LATE_S, PERIOD_S, fraction))
    return subject, q


@pytest.mark.parametrize("lag", ["delay", "low-pass"])
def test_on_a_steady_way_the_arm_is_late_by_look_ahead_and_gain(lag: Lag) -> None:
    _, q = driven(lag, RATE, 1.0)
    behind = RATE * 1.0 - q[-1]
    assert np.allclose(behind, RATE * LATE_S, atol=2.0 * PERIOD_S)


@pytest.mark.parametrize("lag", ["delay", "low-pass"])
def test_an_arm_may_be_later_than_look_ahead_and_gain_have_it(lag: Lag) -> None:
    subject, q = Servo(ServoTruth(lag=lag, more_s=0.1), fastest_joints("ur10e")), np.zeros(6)
    for k in range(round(2.0 / PERIOD_S)):
        q = subject.step(k * PERIOD_S, q.copy, RATE * k * PERIOD_S, LATE_S, PERIOD_S, 1.0)
    assert np.allclose(RATE * 2.0 - q, RATE * (LATE_S + 0.1), atol=2.0 * PERIOD_S)


@pytest.mark.parametrize("lag", ["delay", "low-pass"])
def test_under_the_speed_slider_the_arm_falls_behind_for_as_long_as_it_lasts(lag: Lag) -> None:
    behind = [RATE[4] * s - driven(lag, RATE, s, fraction=0.5)[1][-1][4] for s in (0.5, 1.0, 2.0)]
    assert behind[2] - behind[1] == pytest.approx(0.5, abs=0.02)
    assert behind[1] - behind[0] == pytest.approx(0.25, abs=0.02)


def test_no_joint_turns_faster_than_its_model_lets_and_the_scaling_says_so() -> None:
    subject, q = driven("delay", np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 1.0)
    assert np.max(np.diff(np.array(q), axis=0)) / PERIOD_S <= np.deg2rad(120.0) + 1e-9
    assert subject.limiting(1.0 - PERIOD_S) == pytest.approx(np.deg2rad(120.0) / 3.0, abs=0.01)
    assert subject.limiting(2.0) == 1.0


@pytest.mark.parametrize("lag", ["delay", "low-pass"])
def test_at_full_speed_again_the_arm_catches_up(lag: Lag) -> None:
    subject, q = Servo(ServoTruth(lag=lag), fastest_joints("ur10e")), np.zeros(6)
    cycles = round(3.0 / PERIOD_S)
    for k in range(cycles):
        t = k * PERIOD_S
        q = subject.step(t, q.copy, RATE * t, LATE_S, PERIOD_S, 0.5 if 0.5 <= t < 1.0 else 1.0)
    assert np.allclose(RATE * cycles * PERIOD_S - q, RATE * LATE_S, atol=2.0 * PERIOD_S)


def test_after_set_points_that_came_late_the_arm_is_as_late_as_before() -> None:
    """With a delay, that is: a low-pass makes no leap of one that a joint could not follow."""
    subject, q = Servo(ServoTruth(lag="delay"), fastest_joints("ur10e")), [np.zeros(6)]
    cycles = round(3.0 / PERIOD_S)
    for k in range(cycles):
        t = k * PERIOD_S
        held = k % 250 < 8 and k > 250  # for 16 ms, twice a second, there is no new one
        sent = t - PERIOD_S * (k % 250 + 1) if held else t
        q.append(subject.step(t, q[-1].copy, RATE * sent, LATE_S, PERIOD_S, 1.0))
    assert np.max(np.abs(np.diff(np.array(q), axis=0)) / PERIOD_S / fastest_joints("ur10e")) <= 1.0 + 1e-9
    behind = RATE * cycles * PERIOD_S - q[-1]
    assert np.allclose(behind, RATE * LATE_S, atol=2.0 * PERIOD_S)
    assert subject.limiting((cycles - 1) * PERIOD_S) == 1.0


def test_polynomials_through_a_low_pass_are_what_integrating_them_gives() -> None:
    c = np.array([np.zeros(6), RATE, -0.4 * RATE, 0.3 * RATE])
    sent = Polynomial(1.0, 1.4, 1.0, c)
    subject = Smoothed(sent, LATE_S, np.zeros(6))
    q, h = np.zeros(6), 1e-4
    for t in np.arange(1.0, sent.t_end + 0.2, h):
        middle = sent.at(t + 0.5 * h)[0]
        q = middle + np.exp(-h / LATE_S) * (q - middle)
    assert np.allclose(subject.at(sent.t_end + 0.2)[0], q, atol=1e-6)
    for t in (1.1, 1.39, 1.41, 1.5):
        slope = (subject.at(t + 1e-6)[0] - subject.at(t - 1e-6)[0]) / 2e-6
        assert np.allclose(subject.at(t)[1], slope, atol=1e-6)
    end, speed = subject.at(subject.t_end)
    assert np.allclose(end, sent.at(sent.t_end)[0])
    assert not speed.any()


def test_what_is_reported_is_noisy_about_what_is_so_and_two_looks_agree() -> None:
    subject = Reported(ReportedTruth(q_noise_rad=1e-5, qd_noise_rad_s=5e-5, force_bias_n=2.0), seed=3)
    q = np.array([subject.joints(t, np.zeros(6), np.zeros(6)) for t in np.arange(0.0, 4.0, 0.01)])
    assert np.std(q[:, 0]) == pytest.approx(1e-5, rel=0.1)
    assert np.std(q[:, 1]) == pytest.approx(5e-5, rel=0.1)
    assert np.array_equal(subject.joints(1.0, RATE, RATE)[0], subject.joints(1.0, RATE, RATE)[0])
    assert np.linalg.norm(subject.force(2.0)) == pytest.approx(2.0)


def test_a_controller_may_tell_joints_as_they_were_before_their_stamp() -> None:
    text = shipped_text("picking").replace("q_noise_rad = 0.00001", "stamp_late_s = 0.0015")
    world = World.from_scenario(Scenario.parse(text.replace("qd_noise_rad_s = 0.00005\n", "")), 0.0)
    robot = controller_for(world, "127.0.0.3").robot
    world.track.start_joint_move(1.0, world.track.at(1.0)[0] + RATE, 1.0, 4.0)
    told = robot.instant(1.3)
    q, qd = world.track.at(1.3 - 0.0015)
    assert told.q == pytest.approx(q.tolist())
    assert told.qd == pytest.approx(qd.tolist())
    assert told.q != pytest.approx(world.track.at(1.3)[0].tolist())
    assert world.truth()["robot"]["stamp_late_s"] == 0.0015


def test_a_force_without_contact_walks_by_newtons() -> None:
    subject = Reported(ReportedTruth(force_walk_n=2.0), seed=3)
    force = np.array([subject.force(t) for t in np.arange(0.0, 60.0, 0.5)])
    assert 2.0 < float(np.ptp(force[:16, 2])) + float(np.ptp(force[:, 0])) < 20.0


def test_forces_at_many_times_are_those_of_single_ones_bit_by_bit() -> None:
    subject = Reported(ReportedTruth(force_walk_n=2.0, force_bias_n=1.0), seed=3)
    times = np.arange(1000.0, 1001.0, 0.02).tolist()
    assert np.array_equal(subject.forces(times), [subject.force(t) for t in times])


def test_an_ideal_world_leaves_out_what_is_unkind() -> None:
    real = Scenario.load("picking").world
    ideal = Scenario.load("picking:ideal").world
    assert real.arm.servo.lag == "delay"
    assert ideal.arm.servo == ServoTruth()
    assert ideal.arm.reported == ReportedTruth()
    assert (real.camera.row_time_s > 0.0, ideal.camera.row_time_s) == (True, 0.0)
    assert (real.gripper.close_s, ideal.gripper.close_s) == (0.3, 0.04)


def test_in_an_ideal_world_links_lens_and_print_are_as_told() -> None:
    real, ideal = (Scenario.load(f"workshop{suffix}").world for suffix in ("", ":ideal"))
    assert np.any(real.arm.error.deltas().delta_d)
    assert (ideal.arm.error, ideal.camera.told, ideal.target_print) == (Links(), ToldTruth(), PrintTruth())


def test_the_links_that_a_tracker_measures_keep_their_error_in_an_ideal_world() -> None:
    for name in ("tracker", "palletizer"):
        real, ideal = (Scenario.load(f"{name}{suffix}").world for suffix in ("", ":ideal"))
        assert ideal.arm.error == real.arm.error
        assert ideal.arm.joint_errors == JointErrorsTruth()
        if real.observed is not None:
            assert ideal.observed.error == real.observed.error


LIKE = [name for name in shipped_scenarios() if "\nlike = " in shipped_text(name)]


@pytest.mark.parametrize("name", sorted({*shipped_scenarios()} - {*LIKE}))
def test_the_text_of_an_ideal_world_is_what_its_name_loads(name: str) -> None:
    assert Scenario.parse(ideal_text(name)) == Scenario.load(f"{name}:ideal")


@pytest.mark.parametrize("name", LIKE)
def test_the_ideal_world_of_a_scenario_that_is_like_another_has_no_text(name: str) -> None:
    with pytest.raises(ValueError, match="is like another scenario"):
        ideal_text(name)
    ideal = Scenario.load(f"{name}:ideal").world
    assert ideal.arm.servo == ServoTruth(), "what the other one says is left out, too"


@pytest.mark.parametrize("name", shipped_scenarios())
def test_no_shipped_gripper_closes_at_once(name: str) -> None:
    gripper = Scenario.load(name).world.gripper
    assert gripper is None or min(gripper.close_s, gripper.open_s) >= 0.2


@pytest.mark.parametrize("name", shipped_scenarios())
def test_no_shipped_cell_has_a_model_that_is_quite_true(name: str) -> None:
    world = Scenario.load(name).world
    arm = world.observed or world.arm  # beside an observed arm the other one is parked
    assert arm.error != type(arm.error)()
    assert arm.joint_errors != JointErrorsTruth()
    if world.camera is not None:
        assert world.camera.told != ToldTruth()
        assert world.target_print != PrintTruth()


def test_a_twin_of_an_arm_whose_speeds_nobody_published_needs_those_of_its_controller() -> None:
    truth = Scenario.load("hand_eye:ideal").world
    arm = truth.arm.model_copy(update={"model": "ur8long"})
    with pytest.raises(CellError, match="joints of a ur8long turn was not found published; give"):
        controller_for(World(truth.model_copy(update={"arm": arm}), 0.0), "127.0.0.1")
    told = [1.0, 1.0, 2.0, 3.0, 3.0, 3.0]
    limited = arm.model_copy(update={"controller_limits": ControllerLimitsTruth(joint_speeds_rad_s=told)})
    made = controller_for(World(truth.model_copy(update={"arm": limited}), 0.0), "127.0.0.1")
    assert made.identity.limits.speeds("ur8long").tolist() == told
