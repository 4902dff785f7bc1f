"""Each command of ur-rtde's control script: done in the twin's world, or refused with an error."""

import logging

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.poses import Array
from fakes.ur.control_script import REALTIME
from fakes.ur.runtime import RuntimeState
from fakes.world.arm.reported import Reported
from fakes.world.arm.truth import ReportedTruth
from tests.kit.fake_ur_stepped import CYCLE, HOME, Stepped

NEWEST = (5, 26, 0, 1)
# 5, 13, 14, 22, 23, 32, 48, 49, 50 and 55 are numbers that the script has no branch for; 254 is its own.
NO_COMMANDS = [5, 13, 14, 22, 23, 32, 48, 49, 50, 55, 72, 254, 1000]
PUSH = np.array([3.0, -2.0, 7.0, 0.1, 0.2, -0.3])


def pushing(t: float, T_flange_tcp: RigidTransform) -> Array:
    """Something presses on the tool with the same force for ever."""
    return PUSH


@pytest.fixture
def subject() -> Stepped:
    return Stepped().control()


@pytest.fixture
def pushed() -> Stepped:
    return Stepped(contact=pushing).control()


def died(subject: Stepped) -> str:
    """The text of the error that ended the control script."""
    subject.until(lambda: subject.robot.runtime.program is None, 0.1)
    assert subject.robot.runtime.state in (RuntimeState.STOPPED, RuntimeState.STOPPING)
    assert subject.out(0) != 2
    event, name, text = subject.events[-1]
    assert (event, name) == ("STOPPED", "rtde_control")
    return text


def reported_force(subject: Stepped) -> Array:
    return np.array(subject.robot.instant(subject.t).tcp_force)


@pytest.mark.parametrize("number", NO_COMMANDS)
def test_a_number_that_is_no_command_ends_the_script_with_an_error(subject: Stepped, number: int) -> None:
    subject.register(i0=number)
    assert died(subject) == f"the control script has no command {number}"


@pytest.mark.parametrize(("number", "what"), [(66, "torques"), (67, "masses"), (68, "masses")])
def test_what_the_twin_has_no_model_for_is_refused_and_logged(
    number: int, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    subject = Stepped(NEWEST).control()
    subject.register(i0=number)
    assert what in died(subject)
    assert "the twin has no model" in caplog.text
    assert caplog.records[-1].levelno == logging.WARNING


@pytest.mark.parametrize(
    ("number", "version"),
    [
        (52, (5, 9, 0, 1)),
        (56, (5, 8, 0, 1)),
        (70, (5, 22, 0, 1)),
        (60, (5, 9, 0, 1)),
        (51, (3, 15, 0, 1)),
        (21, (3, 15, 0, 1)),
    ],
)
def test_a_command_without_effect_on_an_old_version_is_refused(
    number: int, version: tuple[int, int, int, int]
) -> None:
    subject = Stepped(version).control()
    subject.register(i0=number)
    number_text = ".".join(map(str, version[:3]))
    assert died(subject) == f"command {number} of the control script does nothing on PolyScope {number_text}"


def test_every_command_that_the_client_repeats_is_known_on_the_newest_version() -> None:
    for number in sorted(REALTIME - {66, 67, 68}):
        subject = Stepped(NEWEST).control()
        target = subject.tcp if number == 24 else subject.q
        subject.vector(target if number in (11, 24) else np.zeros(6))
        subject.register(d8=0.01, i1=2)
        if number in (9, 10):
            subject.register(d6=1.0)
        subject.register(i0=number)
        subject.run(5 * CYCLE)
        assert subject.robot.runtime.program is not None, (number, subject.events)


def test_zeroing_the_sensor_zeroes_the_reported_force_and_not_the_raw_one(pushed: Stepped) -> None:
    np.testing.assert_allclose(reported_force(pushed), PUSH)
    raw = pushed.robot.instant(pushed.t).raw_wrench
    pushed.command(8)
    np.testing.assert_allclose(reported_force(pushed), np.zeros(6), atol=1e-12)
    np.testing.assert_allclose(pushed.robot.instant(pushed.t).raw_wrench, raw)
    # A quarter turn of joint 1 turns the flange, where the sensor was zeroed, and not the push.
    pushed.vector(HOME + np.array([np.pi / 2, 0, 0, 0, 0, 0]))
    pushed.register(d6=3.0, d7=10.0)
    pushed.command(1)
    turned = np.array([-PUSH[1], PUSH[0], PUSH[2], -PUSH[4], PUSH[3], PUSH[5]])
    np.testing.assert_allclose(reported_force(pushed), PUSH - turned, atol=1e-9)


def test_force_mode_moves_along_its_compliant_axis_alone_and_ends_at_rest(subject: Stepped) -> None:
    before = subject.tcp
    force_mode(subject, [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], limit=0.05)
    subject.run(1.0)
    assert subject.robot.modes.mode.name == "FORCE"
    # 10 N at 4 mm/s per N, with the script's gain of 0.5 and damping of 0.025.
    speed = 10 * 0.004 * 0.5 * 0.975
    assert subject.robot.instant(subject.t).tcp_speed[2] == pytest.approx(-speed, rel=1e-3)
    np.testing.assert_allclose(subject.tcp[:2], before[:2], atol=1e-5)
    subject.register(i0=0)
    subject.run(2 * CYCLE)
    subject.command(7)
    assert not subject.robot.arm.moving(subject.t)
    assert subject.robot.modes.mode.name == "POSITION"


def test_force_mode_keeps_to_its_limit_and_rests_where_the_forces_are_equal(pushed: Stepped) -> None:
    force_mode(pushed, [0, 0, 1, 0, 0, 0], [0, 0, -50, 0, 0, 0], limit=0.005)
    pushed.run(0.5)
    assert pushed.robot.instant(pushed.t).tcp_speed[2] == pytest.approx(-0.005, rel=1e-3)
    force_mode(pushed, [0, 0, 1, 0, 0, 0], [0, 0, -float(PUSH[2]), 0, 0, 0], limit=0.005)
    pushed.run(0.5)
    assert pushed.robot.instant(pushed.t).tcp_speed[2] == pytest.approx(0.0, abs=1e-9)


def test_the_parameters_of_force_mode_change_the_speed(subject: Stepped) -> None:
    for number, value in ((20, 0.5), (21, 2.0)):
        subject.register(d0=value)
        subject.command(number)
    force_mode(subject, [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], limit=1.0)
    subject.run(0.5)
    assert subject.robot.instant(subject.t).tcp_speed[2] == pytest.approx(-0.04, rel=1e-3)


@pytest.mark.parametrize(("number", "value"), [(20, 1.5), (20, -0.1), (21, 2.5)])
def test_a_parameter_of_force_mode_outside_its_range_is_refused(
    subject: Stepped, number: int, value: float
) -> None:
    subject.register(d0=value, i0=number)
    assert "is not between 0 and" in died(subject)


@pytest.mark.parametrize("kind", [1, 3])
def test_a_type_of_force_mode_without_a_model_is_refused(subject: Stepped, kind: int) -> None:
    force_mode(subject, [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], limit=0.05, kind=kind)
    assert "type 2 only" in died(subject)


def test_a_move_in_force_mode_is_refused(subject: Stepped) -> None:
    force_mode(subject, [0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 0, 0], limit=0.05)
    subject.run(5 * CYCLE)
    subject.vector(HOME)
    subject.register(d6=1.0, d7=1.0, i1=0, i0=1)
    assert "force mode" in died(subject)
    assert subject.robot.modes.mode.name == "POSITION"


@pytest.mark.parametrize(("begin", "end"), [(18, 19), (52, 53)])
def test_freedrive_keeps_the_arm_in_place_refuses_moves_and_ends(
    subject: Stepped, begin: int, end: int
) -> None:
    before = subject.q
    subject.register(**{f"i{1 + k}": 1 for k in range(6)})
    subject.command(begin)
    assert subject.robot.modes.mode.name == "TEACH"
    subject.run(0.2)
    np.testing.assert_array_equal(subject.q, before)
    subject.command(end)
    assert subject.robot.modes.mode.name == "POSITION"
    subject.command(begin)
    subject.vector(HOME)
    subject.register(d6=1.0, d7=1.0, i1=0, i0=1)
    assert "freedrive" in died(subject)


def test_the_freedrive_status_tells_a_singularity(subject: Stepped) -> None:
    subject.command(54)
    assert subject.out(1) == 0
    stretched = HOME * np.array([1, 1, 0, 1, 1, 1])
    subject.vector(stretched)
    subject.register(d6=3.0, d7=10.0, i1=0)
    subject.command(1)
    subject.command(54)
    assert subject.out(1) == 2


def test_a_circular_servo_brings_the_tcp_to_the_pose(subject: Stepped) -> None:
    goal = subject.tcp + np.array([0.0, 0.02, 0.03, 0.0, 0.0, 0.0])
    subject.vector(goal)
    subject.register(d6=0.25, d7=1.2, d8=0.0, i0=12)
    subject.until(lambda: subject.out(0) == 2)
    # The client goes on without waiting; the motion is done beside the script's loop.
    subject.run(1.0)
    np.testing.assert_allclose(subject.tcp, goal, atol=1e-6)
    subject.register(i0=0)
    subject.run(2 * CYCLE)
    subject.register(d0=10.0)
    subject.command(16)
    assert not subject.robot.arm.moving(subject.t)


def test_an_external_sensor_replaces_the_own_one(pushed: Stepped) -> None:
    pushed.register(**{f"d{k}": 0.0 for k in range(7)})
    pushed.register(i1=1)
    pushed.command(56)
    np.testing.assert_allclose(reported_force(pushed), np.zeros(6), atol=1e-12)
    pushed.robot.inputs.write({"external_force_torque": (0.0, 0.0, 5.0, 0.0, 0.0, 0.0)}, pushed.t)
    turn = pushed.robot.arm.believed.matrix(pushed.q)[:3, :3]
    np.testing.assert_allclose(reported_force(pushed)[:3], turn @ [0, 0, 5.0], atol=1e-12)
    pushed.register(i1=0)
    pushed.command(57)
    np.testing.assert_allclose(reported_force(pushed), PUSH)


def test_an_external_sensor_with_mass_is_refused(subject: Stepped) -> None:
    subject.register(d0=0.3, i1=1, i0=56)
    assert "without mass" in died(subject)


def test_gravity_and_payload_are_kept_as_set(subject: Stepped) -> None:
    subject.vector(np.array([0.0, 9.82, 0.0, 0.0, 0.0, 0.0]))
    subject.command(59)
    assert subject.robot.tool.gravity == (0.0, 9.82, 0.0)
    subject.register(d0=1.5, d1=0.01, d2=0.02, d3=0.03, d4=1e-3, d5=2e-3, d6=3e-3, d7=0, d8=0, d9=0)
    subject.command(65)
    tool = subject.robot.tool
    assert (tool.payload, tool.centre_of_gravity) == (1.5, (0.01, 0.02, 0.03))
    assert tool.inertia == (1e-3, 2e-3, 3e-3, 0.0, 0.0, 0.0)


def test_the_target_waypoint_is_where_the_active_move_ends(subject: Stepped) -> None:
    goal = subject.tcp + np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    subject.vector(goal)
    subject.register(d6=0.05, d7=1.0, i1=1)
    subject.command(3)
    subject.command(28)
    np.testing.assert_allclose(subject.doubles(), goal)
    subject.run(2.0)
    subject.command(28)
    np.testing.assert_allclose(subject.doubles(), subject.tcp)


def test_joint_torques_balance_the_contact_force(pushed: Stepped) -> None:
    pushed.register(i0=38)
    pushed.run(3 * CYCLE)
    # Virtual work: torque times a small turn of each joint is force times the way of the TCP.
    for k in range(6):
        step = np.eye(6)[k] * 1e-6
        way = (pushed.robot.arm.pose6(pushed.q + step) - pushed.robot.arm.pose6(pushed.q - step))[:3] / 2e-6
        axis = pushed.robot.arm.jacobian(pushed.q)[3:, k]
        expected = way @ PUSH[:3] + axis @ PUSH[3:]
        assert pushed.doubles()[k] == pytest.approx(expected, abs=1e-6)


def test_the_jacobian_is_that_of_the_reported_poses_and_its_rate_that_of_the_motion() -> None:
    subject = Stepped(NEWEST).control()
    subject.register(i0=70)
    subject.run(3 * CYCLE)
    matrix = np.concatenate([subject.doubles(24), subject.doubles(12, 36)]).reshape(6, 6).T
    for k in range(6):
        step = np.eye(6)[k] * 1e-6
        after, before = (subject.robot.arm.pose6(subject.q + sign * step)[:3] for sign in (1, -1))
        np.testing.assert_allclose(matrix[:3, k], (after - before) / 2e-6, atol=1e-6)
    subject.register(i0=71)
    subject.run(3 * CYCLE)
    np.testing.assert_allclose(subject.doubles(24), 0.0, atol=1e-12)


def test_the_elbow_is_an_upper_arm_away_from_the_shoulder_and_moves_with_it(subject: Stepped) -> None:
    shoulder, upper_arm_m = np.array([0.0, 0.0, 0.1807]), 0.6127
    subject.vector(np.array([0.0, -0.5, 0.3, 0.0, 0.0, 0.0]))
    subject.register(d6=10.0, d7=0.05, i0=9)
    for _ in range(5):
        subject.run(0.1)
        now = subject.robot.instant(subject.t)
        elbow = np.array(now.elbow_position)
        assert np.linalg.norm(elbow - shoulder) == pytest.approx(upper_arm_m)
        # At q1 = 0 the upper arm points along -x at q2 = 0 and rises when q2 turns below zero.
        expected = shoulder + upper_arm_m * np.array([-np.cos(now.q[1]), 0.0, -np.sin(now.q[1])])
        np.testing.assert_allclose(elbow, expected, atol=1e-9)
        speed = np.linalg.norm(now.elbow_velocity)
        assert speed == pytest.approx(abs(now.qd[1]) * upper_arm_m, rel=1e-3)


@pytest.mark.parametrize("late_s", [0.002, 0.0013])
def test_what_a_late_state_has_by_difference_is_of_its_own_time(subject: Stepped, late_s: float) -> None:
    def changes(t: float) -> list[list[float]]:
        now = subject.robot.instant(t)
        return [now.qdd, now.tcp_acceleration, now.elbow_velocity]

    subject.vector(np.array([0.0, -0.5, 0.3, 0.0, 0.0, 0.0]))
    subject.register(d6=10.0, d7=0.05, i0=9)
    subject.run(0.02)  # it still gains speed
    expected = changes(subject.t - late_s)
    assert all(np.linalg.norm(one) > 1e-3 for one in expected)
    subject.robot.reported = Reported(ReportedTruth(stamp_late_s=late_s), 0)
    for told, own in zip(changes(subject.t), expected, strict=True):
        np.testing.assert_allclose(told, own, rtol=1e-6, atol=1e-9)


def force_mode(
    subject: Stepped, selection: list[int], wrench: list[float], limit: float, kind: int = 2
) -> None:
    """The client's forceMode() in the base's frame."""
    subject.vector(np.zeros(6))
    subject.vector(np.array(wrench, dtype=float), 6)
    subject.vector(np.full(6, limit), 12)
    subject.register(**{f"i{2 + k}": s for k, s in enumerate(selection)})
    subject.register(i1=kind, i0=6)
