"""Moves through the genuine client in its child process, against a controller on the wire."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from ur_driver_rig import LASTING, TOOL, Rig, own_pauses, rests, start, until, untouched

from cell.clock import MonotonicClock
from cell.devices import ArmState, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError, error
from cell.motion import MotionBroker
from cell.poses import from_pose6
from cell.samples import Sample
from cell.testing.taken_again import ends_by
from drivers.ur import UrArm
from fakes.world.scenario import Scenario

SPEED = Speed(tcp_m_s=0.25, tcp_m_s2=1.0, joint_rad_s=1.0, joint_rad_s2=4.0)
SLOW = Speed(tcp_m_s=0.02, tcp_m_s2=0.5, joint_rad_s=0.05, joint_rad_s2=0.5)
pytestmark = pytest.mark.wire


@pytest.fixture(scope="module")
def shared() -> Iterator[Rig]:
    with Rig.running() as rig:
        yield rig


@pytest.fixture
def rig(shared: Rig, request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The module's controller, or one of its own for a test that spoils it."""
    call = getattr(request.node, "callspec", None)
    if call is not None and call.params.get("fault") in LASTING:
        with Rig.running() as own:
            yield own
    else:
        yield shared
        shared.tidy()


def joints(arm: UrArm) -> np.ndarray:
    return arm.state.latest(0.5).value.q.copy()


def turned(arm: UrArm, angle: float) -> np.ndarray:
    return joints(arm) + np.array([angle, 0, 0, 0, 0, 0])


def test_a_joint_move_ends_where_the_truth_says(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            target = turned(arm, 0.3)
            await port.move_joints(target, SPEED)
            np.testing.assert_allclose(rig.truth()["q"], target, atol=1e-3)
            assert rig.truth()["payload_kg"] == pytest.approx(1.2)
            assert arm.health()["motion_child"] is not None
        assert rig.truth()["program"] is None

    rig.play(scenario)


def test_a_linear_move_brings_the_flange_to_its_pose(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            start_pose = arm.state.latest(0.5).value.T_base_flange
            target = from_pose6([0.03, 0.04, -0.05, 0.0, 0.0, 0.0]) * start_pose
            await port.move_linear(target, SPEED)
            reached = arm.state.latest(0.5).value.T_base_flange
            np.testing.assert_allclose(reached.translation, target.translation, atol=5e-4)
            tcp = from_pose6(rig.truth()["tcp_pose"])
            expected = target * TOOL.T_flange_tool
            np.testing.assert_allclose(tcp.translation, expected.translation, atol=5e-4)
            assert (tcp.rotation.inv() * expected.rotation).magnitude() < 1e-3

    rig.play(scenario)


def test_setting_the_tcp_starts_an_epoch_and_keeps_the_flange(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected() as arm:
            await arm.wait_fresh(1.0)
            epoch, flange = arm.state.epoch, arm.state.latest(0.5).value.T_base_flange
            port = await arm.open_motion(ToolSettings(from_pose6([0.01, 0.0, 0.123, 0.0, 0.1, 0.0]), 0.4))
            await arm.wait_fresh(1.0)
            assert arm.state.epoch == epoch + 1
            after = arm.state.latest(0.5).value
            np.testing.assert_allclose(after.tcp_offset6, [0.01, 0, 0.123, 0, 0.1, 0], atol=1e-9)
            np.testing.assert_allclose(after.T_base_flange.translation, flange.translation, atol=1e-9)
            await port.close()
            await asyncio.sleep(0.6)
            # The primary port agrees, so nothing changes when it takes over again.
            assert arm.state.epoch == epoch + 1

    rig.play(scenario)


def quintic(t0: float, duration: float, q0: np.ndarray, travel: np.ndarray) -> TrajectoryPiece:
    """Rest to rest (Craig, Introduction to Robotics, 7.3)."""
    c = np.zeros((6, 6))
    c[0] = q0
    c[3], c[4], c[5] = (k * travel / duration**p for k, p in ((10, 3), (-15, 4), (6, 5)))
    return TrajectoryPiece(t0, t0 + duration, c)


def test_a_streamed_trajectory_is_followed_in_time(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            travel = np.array([0.2, 0.0, 0.0, 0.0, 0.1, 0.0])
            piece = quintic(time.monotonic() + 0.3, 0.8, joints(arm), travel)

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                yield piece

            await port.stream(pieces())
            await rests(arm, 1.0)
            np.testing.assert_allclose(joints(arm), piece.coefficients[0] + travel, atol=1e-3)
            middle = [s for s in arm.state.between(piece.t0, piece.t1) if abs(s.value.qd[0]) > 0.3]
            lags = [s.t - _instant_of(piece, s.value.q[0]) for s in middle]
            # The arm follows with the servo's look-ahead, not with a delay of its own.
            assert 0.0 < np.median(lags) < 0.12

    rig.play(scenario)


def _instant_of(piece: TrajectoryPiece, q: float) -> float:
    t = np.linspace(0.0, piece.t1 - piece.t0, 4000)
    planned = np.polynomial.polynomial.polyval(t, piece.coefficients[:, 0])
    return piece.t0 + float(np.interp(q, planned, t))


def test_a_stream_that_is_not_renewed_ends_in_rest_and_says_so(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            q0, t0 = joints(arm), time.monotonic() + 0.3

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                yield TrajectoryPiece(t0, t0 + 0.3, np.array([q0, [0.3, 0, 0, 0, 0, 0]]))
                await asyncio.sleep(5.0)

            async with own_pauses() as pauses:
                with ends_by("MOTION_WATCHDOG", match="not renewed"):
                    await port.stream(pieces())
            await rests(arm, 1.0)
            untouched(pauses)  # the stream ends earlier, too, when the beat is late
            assert 0.08 < joints(arm)[0] - q0[0] < 0.12

    rig.play(scenario)


def test_a_stream_that_begins_elsewhere_is_refused_at_rest(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            q0 = joints(arm)

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                now = time.monotonic()
                yield TrajectoryPiece(now, now + 0.5, np.array([q0 + 0.2]))

            with ends_by("MOTION_LIMIT"):
                await port.stream(pieces())
            np.testing.assert_allclose(rig.truth()["q"], q0, atol=1e-6)

    rig.play(scenario)


def test_a_guarded_move_without_contact_ends_after_its_travel(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            start_pose = arm.state.latest(0.5).value.T_base_flange
            target = from_pose6([0.0, 0.0, -0.2, 0.0, 0.0, 0.0]) * start_pose
            assert not await port.guarded_move(target, SPEED, max_force_n=20.0, max_travel_m=0.05)
            travel = arm.state.latest(0.5).value.T_base_flange.translation - start_pose.translation
            np.testing.assert_allclose(travel, [0.0, 0.0, -0.05], atol=1e-3)

    rig.play(scenario)


def test_a_guarded_move_stops_at_the_force(tmp_path: Path) -> None:
    text = files("fakes").joinpath("scenarios", "hand_eye.toml").read_text("utf-8")
    surface = (
        "[[world.obstacle]]\npoint = [0.0, 0.0, 0.45]\nnormal = [0.0, 0.0, 1.0]\nstiffness_n_m = 5000.0\n"
    )
    scenario_file = tmp_path / "table.toml"
    scenario_file.write_text(text + "\n" + surface, "utf-8")
    force_n, speed_m_s, decel_m_s2 = 20.0, 0.02, 0.5
    above = np.array(Scenario.parse(text).world.arm.q_start)

    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            await port.move_joints(above, SPEED)  # from wherever a pause may have ended it
            await asyncio.sleep(0.1)
            state = arm.state.latest(2.0).value
            assert state.tcp_pose6[2] > 0.47
            target = from_pose6([0.0, 0.0, -0.06, 0.0, 0.0, 0.0]) * state.T_base_flange
            samples: list[Sample[ArmState]] = []
            stops: list[float] = []  # the newest stamp at each
            post = port.client.post

            def noting(do: str, **arguments: Any) -> None:
                stops.append(samples[-1].t)
                post(do, **arguments)

            port.client.post = noting  # type: ignore[method-assign]
            arm.state.subscribe(samples.append)  # before the port's own look at the same sample
            slow = Speed(speed_m_s, decel_m_s2, 0.5, 1.0)
            assert await port.guarded_move(target, slow, max_force_n=force_n, max_travel_m=0.2)
            await rests(arm, 1.0)
            over = [s for s in samples if s.value.tcp_force[2] > force_n]
            slower = next(s for s in over if s.value.tcp_speed[2] > -0.9 * speed_m_s)
            assert stops[0] <= over[0].t, "the stop is sent from within the sample that shows the force"
            # From there on the arm goes as far as a stop needs, however late this machine was before.
            z = arm.state.latest(2.0).value.tcp_pose6[2]
            assert slower.value.tcp_pose6[2] - z < speed_m_s**2 / (2.0 * decel_m_s2) + 0.0005
            assert z < 0.45 - force_n / 5000.0 + 0.0005

    with Rig.running(scenario=scenario_file) as rig:
        rig.play(scenario)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("protective-stop", "ARM_PROTECTIVE_STOP"),
        ("script-death", "ARM_SCRIPT_DIED"),
        ("kill", "DEVICE_LOST"),
        ("reboot", "DEVICE_LOST"),
    ],
)  # one of each way to be told; the arm's contract has all the others
def test_a_fault_ends_the_move_with_its_code_at_once(rig: Rig, fault: str, name: str) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            shown: list[float] = []
            arm.state.subscribe(
                lambda s: shown.append(s.t) if arm.fault() or not s.value.program_running else None
            )
            move = await start(arm, port.move_joints(turned(arm, 1.0), SLOW))
            async with own_pauses() as pauses:
                await asyncio.to_thread(rig.inject, fault)
                with ends_by(name):
                    async with asyncio.timeout(10.0):
                        await move
                ended = time.monotonic()
            since = shown[0] if shown else arm.lost_at
            assert ended - since - sum(pauses) < 0.25

    rig.play(scenario)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("register-in-use", "ARM_REGISTER_CONFLICT"),
        ("foreign-program", "ARM_PROGRAM_RUNNING"),
    ],
)
def test_motion_is_refused_and_nothing_of_ours_stays(rig: Rig, fault: str, name: str) -> None:
    async def scenario() -> None:
        async with rig.connected() as arm:
            await asyncio.to_thread(rig.inject, fault)
            await asyncio.sleep(0.3)
            with ends_by(name):
                await arm.open_motion(TOOL)
            assert arm.health()["motion_child"] is None
            assert rig.truth()["program"] == ("foreign" if fault == "foreign-program" else None)
            assert arm.lost is None

    rig.play(scenario)


def test_a_program_started_in_the_last_moment_is_seen_by_the_dashboard(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.connected() as arm:
            await asyncio.to_thread(rig.inject, "foreign-program")
            await asyncio.sleep(0.2)
            arm.feed.runtime_state = 1
            with ends_by("ARM_PROGRAM_RUNNING"):
                await arm._ask_permission()

    rig.play(scenario)


def test_a_lease_that_fails_before_our_client_runs_leaves_a_foreign_program_alone(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program comes up between our look at the state and the dashboard's answer, which never comes."""

    async def scenario() -> None:
        async with rig.connected() as arm:

            async def deaf() -> None:
                await asyncio.to_thread(rig.inject, "foreign-program")
                await asyncio.sleep(0.3)
                raise error("CALL_TIMEOUT", "the dashboard")

            monkeypatch.setattr(arm, "_ask_permission", deaf)
            broker, notes = MotionBroker(MonotonicClock()), Notes()
            with ends_by("CALL_TIMEOUT"):
                async with broker.lease(arm, OpenGuard(), TOOL, SPEED, notes):
                    pass
            await asyncio.sleep(0.3)
            assert rig.truth()["program"] == "foreign"
            assert not arm.motion_begun

    rig.play(scenario)


def test_closing_the_port_leaves_a_later_foreign_program_alone(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (_, port):
            await asyncio.to_thread(rig.inject, "foreign-program")
            await until(lambda: not port.owns_program)
            await port.close()
            await asyncio.sleep(0.2)
            assert rig.truth()["program"] == "foreign"

    rig.play(scenario)


def test_a_paused_script_is_not_left_behind() -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            move = await start(arm, port.move_joints(turned(arm, 1.0), SLOW))
            await asyncio.to_thread(rig.inject, "protective-stop")
            with pytest.raises(CellError):
                await move
        assert rig.truth()["program"] is None

    with Rig.running() as rig:
        rig.play(scenario)


def test_decelerating_stops_the_arm_and_the_next_move_works(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            move = await start(arm, port.move_joints(turned(arm, 2.0), SPEED))
            await port.decelerate()
            await rests(arm, 0.5)
            with ends_by("ARM_NOT_AT_TARGET"):
                await move
            await port.move_joints(turned(arm, -0.05), SPEED)
            await port.decelerate()

    rig.play(scenario)


def test_a_cancelled_move_stops_the_arm(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            move = await start(arm, port.move_joints(turned(arm, 2.0), SPEED))
            move.cancel()
            await rests(arm, 1.0)

    rig.play(scenario)


def test_decelerating_ends_a_stream(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            piece = quintic(time.monotonic() + 0.05, 5.0, joints(arm), np.array([1.0, 0, 0, 0, 0, 0]))

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                yield piece

            follow = await start(arm, port.stream(pieces()))
            await port.decelerate()
            await rests(arm, 1.0)
            with pytest.raises(CellError, match="stopped"):
                await follow

    rig.play(scenario)


def test_a_killed_child_is_found_and_the_watchdog_stops_the_arm(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            move = await start(arm, port.move_joints(turned(arm, 2.0), SPEED))
            os.kill(port.client.pid, signal.SIGKILL)
            with ends_by("CHILD_DIED"):
                await move
            await rests(arm, 1.0)
        async with rig.movable() as (arm, port):
            await port.move_joints(turned(arm, 0.05), SPEED)

    rig.play(scenario)


def test_a_hung_child_is_killed_on_its_deadline(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            move = await start(arm, port.move_joints(turned(arm, 2.0), SPEED))
            os.kill(port.client.pid, signal.SIGSTOP)
            asked = time.monotonic()
            async with own_pauses() as pauses:
                with ends_by("CALL_TIMEOUT"):
                    await port.decelerate()
            assert time.monotonic() - asked - sum(pauses) < 1.0
            await rests(arm, 1.0)
            with pytest.raises(CellError):
                await move

    rig.play(scenario)


def test_a_daemon_that_stops_beating_stops_the_arm(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            move = await start(arm, port.move_joints(turned(arm, 2.0), SPEED))
            port.client._beating.cancel()
            with ends_by("MOTION_WATCHDOG"):
                await move
            await rests(arm, 1.0)

    rig.play(scenario)


_DAEMON = """
import asyncio, sys
from cell.clock import MonotonicClock
from drivers.ur.motion_client import MotionClient

async def main():
    client = MotionClient.start(MonotonicClock())
    print(client.pid, flush=True)
    await asyncio.sleep(30)

asyncio.run(main())
"""


def test_the_child_dies_with_a_killed_daemon() -> None:
    import subprocess
    import sys

    root = str(Path(__file__).parents[2])
    daemon = subprocess.Popen([sys.executable, "-c", _DAEMON], stdout=subprocess.PIPE, cwd=root, text=True)
    assert daemon.stdout is not None
    with daemon, daemon.stdout:
        child = psutil.Process(int(daemon.stdout.readline()))
        time.sleep(0.5)
        assert child.is_running()
        daemon.kill()
        daemon.wait()
        _, alive = psutil.wait_procs([child], timeout=2.0)
        assert not alive


def test_numbers_that_make_no_sense_never_reach_the_arm(rig: Rig) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            for target in (np.zeros(5), np.full(6, np.nan)):
                with ends_by("ARGUMENT_INVALID"):
                    await port.move_joints(target, SPEED)
            assert not rig.truth()["moving"]
            await port.move_joints(turned(arm, 0.05), SPEED)

    rig.play(scenario)


class OpenGuard:
    """Lets everything pass."""

    def check_path_joints(self, q0: Any, q1: Any) -> None: ...
    def check_path_linear(self, T0: Any, T1: Any, q0: Any, speed_m_s: Any = None) -> None: ...
    def check_setpoints(self, Q: Any, Qd: Any) -> None: ...


class Notes(list[dict[str, Any]]):
    """A recorder that keeps everything."""

    def note(self, kind: str, **fields: Any) -> None:
        self.append({"kind": kind, **fields})


def test_a_lease_that_is_cancelled_three_times_ends_in_rest_without_a_program(rig: Rig) -> None:
    async def scenario() -> None:
        notes = Notes()
        async with rig.connected() as arm:
            broker = MotionBroker(MonotonicClock())

            async def job() -> None:
                async with broker.lease(arm, OpenGuard(), TOOL, SPEED, notes) as lease:
                    await lease.move_joints(turned(arm, 2.0))

            task = await start(arm, job())
            assert rig.truth()["moving"]
            async with own_pauses() as pauses:
                for _ in range(3):
                    task.cancel()
                    await asyncio.sleep(0.02)
                with pytest.raises(asyncio.CancelledError):
                    await task
            untouched(pauses)  # who is late takes the next step of the ladder
            assert [n["after"] for n in notes if n.get("event") == "standstill"] == ["decelerate"]
            assert not rig.truth()["moving"]
            assert rig.truth()["program"] is None
            assert broker.latched is None
            arm.check_movable()

    rig.play(scenario)
