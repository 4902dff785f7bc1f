"""What ends a move, and refuses the next: faults, other programs, stops, and a motion client that dies."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from ur_driver_rig import TOOL, Rig, own_pauses, rests, start, until, untouched
from ur_motion_scene import SLOW, SPEED, joints, quintic, rig, shared, turned

from cell.clock import MonotonicClock
from cell.devices import TrajectoryPiece
from cell.errors import CellError, error
from cell.motion import MotionBroker
from cell.testing.taken_again import ends_by

__all__ = ["rig", "shared"]
pytestmark = pytest.mark.wire


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
