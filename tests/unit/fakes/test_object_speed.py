"""On virtual time, too, the arm goes by the speed slider and by the limits of its joints."""

from collections.abc import AsyncIterator
from contextlib import aclosing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.devices import Speed, TrajectoryPiece
from cell.poses import from_pose6
from fakes.object import ObjectArm, VirtualClock, run_virtual
from fakes.object.stream_time import StreamTime
from fakes.world.arm.joint_speeds import fastest_joints
from fakes.world.arm.segments import Polynomial
from fakes.world.arm.servo import Servo
from fakes.world.arm.track import Track
from fakes.world.arm.truth import ArmTruth, Lag, ServoTruth
from tests.kit.ideal_world import shipped_text
from tests.unit.fakes.test_object_arm import SLOW, TOOL, arm_on

PERIOD_S, LATE_S = 0.002, 0.05
CUBIC = np.array([[0.0] * 6, [0.0] * 6, [0.6, -0.3, 0.5, 0.0, 1.0, 0.1], [-0.1] * 6])


def truth(lag: Lag) -> ArmTruth:
    return ArmTruth(model="ur10e", q_start=[0.0] * 6, servo=ServoTruth(lag=lag))


def followed(lag: Lag, coefficients: Any, slider: list[tuple[float, float]]) -> tuple[StreamTime, Track]:
    """Pieces of 20 ms that reach 100 ms ahead, for a second; ``slider`` has times and fractions."""
    track, changes = Track(0.0, np.zeros(6)), list(slider)
    subject = StreamTime(track, truth(lag), 7)
    for k in range(50):
        t = 0.02 * k
        while changes and changes[0][0] <= t:
            subject.set_fraction(*changes.pop(0))
        subject.follow(Polynomial(t, t + 0.1, 0.0, coefficients), LATE_S)
    return subject, track


@pytest.mark.parametrize("lag", ["delay", "low-pass"])
@pytest.mark.parametrize("slider", [[], [(0.0, 0.5)], [(0.31, 0.5)], [(0.21, 0.8), (0.57, 0.3)]])
def test_a_stream_is_followed_as_cycle_by_cycle(lag: Lag, slider: list[tuple[float, float]]) -> None:
    _, track = followed(lag, CUBIC, slider)
    servo, q = Servo(ServoTruth(lag=lag), fastest_joints("ur10e")), np.zeros(6)
    for k in range(500):
        t = k * PERIOD_S
        fraction = next((f for since, f in reversed(slider) if since <= t), 1.0)
        sent = Polynomial(0.0, 1.0, 0.0, CUBIC).at(t)[0]
        q = servo.step(t, q.copy, sent, LATE_S, PERIOD_S, fraction)
        # A change between two pieces is seen at the next one here; a cycle is 2.5 mrad at the end.
        assert track.at(t + PERIOD_S)[0] == pytest.approx(q, abs=0.015)
    behind = Polynomial(0.0, 1.0, 0.0, CUBIC).at(1.0)[0] - q
    assert (np.max(behind) > 0.2) == bool(slider)


def test_no_joint_turns_faster_than_its_model_lets_and_the_scaling_says_so() -> None:
    ramp = np.zeros((3, 6))
    ramp[2, 0] = 2.0  # 120 deg/s are reached after 0.52 s, and 4 rad/s asked for after a second
    subject, track = followed("delay", ramp, [])
    speeds = np.array([track.at(t)[1][0] for t in np.arange(0.0, 1.0, 0.001)])
    assert np.deg2rad(119.0) < np.max(speeds) <= np.deg2rad(120.0) + 1e-9
    assert subject.limiting(0.4) == 1.0
    assert subject.limiting(0.9) == pytest.approx(np.deg2rad(120.0) / 3.6, abs=0.02)
    assert subject.limiting(1.2) == 1.0


async def steady(arm: ObjectArm, rate: float) -> AsyncIterator[TrajectoryPiece]:
    """Joint 6 at ``rate``, rad/s, for half a second."""
    q0, begin = arm.state.latest(0.1).value.q, arm.clock.now()
    turn = rate * np.eye(6)[5]
    for k in range(25):
        t = 0.02 * k
        yield TrajectoryPiece(begin + t, begin + t + 0.1, np.array([q0 + t * turn, turn]))
        await arm.clock.sleep(0.02)


@pytest.mark.parametrize(("slider", "limit", "told"), [(0.5, 5.0, 0.5), (1.0, 0.1, 0.5), (1.0, 5.0, 1.0)])
def test_a_stream_that_is_slowed_is_told(tmp_path: Path, slider: float, limit: float, told: float) -> None:
    limits = f"[world.arm.controller_limits]\njoint_speeds_rad_s = {[limit] * 6}\n\n[world.arm.servo]\n"
    path = tmp_path / "limited.toml"
    path.write_text(shipped_text("hand_eye").replace("[world.arm.servo]\n", limits), "utf-8")

    async def scene() -> None:
        arm = arm_on(VirtualClock(), str(path))
        await arm.open()
        port = await arm.open_motion(TOOL)
        arm.inject("speed-slider", fraction=slider)
        begin = arm.clock.now()
        async with aclosing(steady(arm, 0.2)) as pieces:
            await port.stream(pieces)
        scaling = [s.value.speed_scaling for s in arm.state.between(begin + 0.1, begin + 0.5)]
        assert scaling == pytest.approx([told] * len(scaling))
        await port.close()
        await arm.close()

    run_virtual(scene())


@pytest.mark.parametrize("late_s", [0.0, 0.0015])
def test_an_arm_tells_joints_as_they_were_before_their_stamp(tmp_path: Path, late_s: float) -> None:
    noise = "q_noise_rad = 0.00001\nqd_noise_rad_s = 0.00005"
    path = tmp_path / "late.toml"
    path.write_text(shipped_text("hand_eye").replace(noise, f"stamp_late_s = {late_s}"), "utf-8")

    async def scene() -> None:
        arm = arm_on(VirtualClock(), str(path))
        await arm.open()
        port = await arm.open_motion(TOOL)
        begin = arm.clock.now()
        await port.move_joints(arm.state.latest(0.1).value.q + 0.3, SLOW)
        told = arm.state.between(begin, arm.clock.now())
        track = arm.world.track
        assert sum(bool(s.value.qd.any()) for s in told) > 20
        for s in told:
            q, qd = track.at(s.t - late_s)
            assert s.value.q == pytest.approx(q, abs=1e-9)
            assert s.value.qd == pytest.approx(qd, abs=1e-9)
        await port.close()
        await arm.close()

    run_virtual(scene())


@pytest.mark.parametrize("kind", ["joints", "linear"])
def test_a_move_takes_longer_under_the_slider(kind: str) -> None:
    async def took(fraction: float) -> float:
        arm = arm_on(VirtualClock())
        await arm.open()
        port = await arm.open_motion(TOOL)
        arm.inject("speed-slider", fraction=fraction)
        begin, state = arm.clock.now(), arm.state.latest(0.1).value
        if kind == "joints":
            await port.move_joints(state.q + 0.5, SLOW)
        else:
            await port.move_linear(
                state.T_base_flange * from_pose6([0, 0, 0.05, 0, 0, 0]), Speed(0.02, 1.0, 0.5, 1.0)
            )
        taken = arm.clock.now() - begin
        await port.close()
        await arm.close()
        return taken

    assert run_virtual(took(0.5)) == pytest.approx(2.0 * run_virtual(took(1.0)), rel=0.15)
