"""The lease ends in measured standstill, whatever happens to the one who holds it."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.devices import ArmState, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError, error
from cell.interruptions import Interruptions
from cell.motion import TAKE_UP_REST_S
from cell.samples import Sample
from cell.standstill import measured_standstill
from fakes.object.loop import run_virtual
from tests.kit.motion_bench import (
    SPEED,
    TARGET,
    Bench,
    OpenGuard,
    ScriptedArm,
    bench_with,
    no_wait,
)


def cancel_times(count: int) -> Callable[[Bench], Any]:
    async def scenario(bench: Bench) -> None:
        task = asyncio.create_task(bench.drive())
        await asyncio.sleep(0.5)
        assert bench.arm.moving
        for _ in range(count):
            task.cancel()
            await asyncio.sleep(0.001)
        with pytest.raises(asyncio.CancelledError):
            await task

    return scenario


async def time_out(bench: Bench) -> None:
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.5):
            await bench.drive()


async def failing_sibling(bench: Bench) -> None:
    async def fail() -> None:
        await asyncio.sleep(0.5)
        raise error("DEVICE_LOST", "camera")

    with pytest.raises(ExceptionGroup):
        async with asyncio.TaskGroup() as group:
            group.create_task(bench.drive())
            group.create_task(fail())


async def error_in_the_block(bench: Bench) -> None:
    with pytest.raises(ZeroDivisionError):
        async with bench.lease():
            bench.arm.moving = True
            raise ZeroDivisionError


ENDS = {
    "one cancel": cancel_times(1),
    "two cancels": cancel_times(2),
    "three cancels": cancel_times(3),
    "time-out": time_out,
    "failing sibling": failing_sibling,
    "error": error_in_the_block,
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("obeys", ["decelerate", "stop_script", "stop_program"])
def test_every_end_reaches_standstill_on_the_first_step_that_works(end: str, obeys: str) -> None:
    async def main() -> None:
        async with bench_with(ScriptedArm({obeys})) as bench:
            await ENDS[end](bench)
            assert not bench.arm.moving
            assert len(bench.notes.standstill_after()) == 1
            assert bench.arm.asked[-1] == "close"
            assert bench.broker.latched is None

    run_virtual(main())


@pytest.mark.parametrize("cancels", [1, 2])
def test_who_makes_the_pieces_of_a_stream_has_ended_when_the_lease_has(cancels: int) -> None:
    ended: list[str] = []

    async def pieces() -> AsyncIterator[TrajectoryPiece]:
        try:
            while True:
                yield TrajectoryPiece(0.0, 0.05, np.zeros((1, 6)))
        finally:
            await asyncio.sleep(0.0)
            ended.append("pieces")

    async def drive(bench: Bench) -> None:
        async with bench.lease() as lease:
            await lease.stream(pieces())

    async def main() -> None:
        async with bench_with(ScriptedArm()) as bench:
            task = asyncio.create_task(drive(bench))
            await asyncio.sleep(0.5)
            assert bench.arm.moving
            for _ in range(cancels):
                task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert ended, "they were left to the collection of garbage"
            assert not bench.arm.moving

    run_virtual(main())


def test_a_step_that_hangs_is_given_up_and_the_next_one_follows() -> None:
    async def main() -> None:
        arm = ScriptedArm({"stop_program"}, hang={"decelerate", "stop_script", "close"})
        async with bench_with(arm) as bench:
            start = arm.clock.now()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.1):
                    await bench.drive()
            assert bench.notes.standstill_after() == ["dashboard stop"]
            assert arm.clock.now() - start < 8.0

    run_virtual(main())


@pytest.mark.parametrize("silent", [False, True])
def test_no_standstill_or_no_samples_lock_motion(silent: bool) -> None:
    async def main() -> None:
        arm = ScriptedArm(set() if not silent else {"decelerate"})
        async with bench_with(arm) as bench:

            async def go_dark() -> None:
                await asyncio.sleep(0.2)
                arm.silent = silent

            dark = asyncio.create_task(go_dark())
            with pytest.raises(CellError, match="No standstill"):
                async with asyncio.timeout(0.5):
                    await bench.drive()
            await dark
            with pytest.raises(CellError, match="locked after a fault"):
                await bench.drive()
            bench.broker.reset()
            assert bench.broker.latched is None

    run_virtual(main())


@pytest.mark.parametrize("name", ["ARM_PROGRAM_RUNNING", "ARM_LOCAL_MODE"])
def test_a_refused_lease_touches_nothing_on_the_robot(name: str) -> None:
    async def main() -> None:
        arm = ScriptedArm(refusal=error(name))
        async with bench_with(arm) as bench:
            with pytest.raises(CellError) as refusal:
                await bench.drive()
            assert refusal.value.name == name
            assert arm.asked == []
            arm.refusal = None
            await cancel_times(1)(bench)

    run_virtual(main())


def test_a_client_that_never_comes_up_is_stopped_too() -> None:
    async def main() -> None:
        arm = ScriptedArm({"stop_script"}, hang={"open"})
        async with bench_with(arm) as bench:
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(1.0):
                    await bench.drive()
            assert "stop_script" in arm.asked
            assert bench.notes.standstill_after() == ["stop script"]

    run_virtual(main())


def test_a_client_that_never_began_leaves_no_stop_script_on_a_resting_arm() -> None:
    async def main() -> None:
        arm = ScriptedArm(hang={"open"}, program_running=False)
        async with bench_with(arm) as bench:
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(1.0):
                    await bench.drive()
            assert arm.asked == ["open"]
            assert bench.notes.standstill_after() == ["no motion"]

    run_virtual(main())


def test_an_opening_that_failed_before_our_client_was_started_leaves_a_foreign_program_alone() -> None:
    async def main() -> None:
        arm = ScriptedArm(hang={"open"}, motion_begun=False)  # somebody's program runs meanwhile
        async with bench_with(arm) as bench:
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(1.0):
                    await bench.drive()
            assert arm.asked == ["open"]
            arm.hang, arm.motion_begun = set(), True
            await cancel_times(1)(bench)  # the arm was not left lent

    run_virtual(main())


@pytest.mark.parametrize("offset_s", [-0.3, 0.3])
def test_an_offset_of_the_stamps_does_not_change_when_standstill_is_seen(offset_s: float) -> None:
    async def main() -> None:
        arm = ScriptedArm(time_offset_s=offset_s)
        async with bench_with(arm):
            assert await measured_standstill(arm, 0.1)  # type: ignore[arg-type]
            arm.moving = True
            await asyncio.sleep(0.02)
            assert not await measured_standstill(arm, 0.5)  # type: ignore[arg-type]

    run_virtual(main())


def test_samples_that_waited_and_are_read_at_once_are_no_standstill() -> None:
    async def main() -> None:
        arm = ScriptedArm(silent=True)
        async with bench_with(arm):
            looking = asyncio.create_task(measured_standstill(arm, 0.5))  # type: ignore[arg-type]
            await asyncio.sleep(0.1)
            zero = np.zeros(6)
            state = ArmState(zero, zero, zero, zero, zero, 7, 1, True, 0, 0, 0.0)
            for k in range(20):
                arm.state.push(Sample(state, arm.clock.now() - 0.2 + 0.01 * k, 0.001, k))
            assert not await looking

    run_virtual(main())


def test_a_full_disk_does_not_keep_the_stop_ladder_from_its_next_step() -> None:
    async def main() -> None:
        arm = ScriptedArm({"stop_program"}, hang={"decelerate", "stop_script"})
        async with bench_with(arm) as bench:
            task = asyncio.create_task(bench.drive())
            await asyncio.sleep(0.5)
            bench.notes.disk_full = True
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert not arm.moving
            with pytest.raises(CellError, match="full"):
                await bench.drive()
            bench.notes.disk_full = False
            await cancel_times(1)(bench)  # the arm was not left lent

    run_virtual(main())


@pytest.mark.parametrize(("stale", "moves"), [(3, True), (4, False)])
def test_a_move_begins_when_the_state_is_fresh_after_some_looks_and_not_without(
    stale: int, moves: bool
) -> None:
    """On a busy machine a fresh state may be old again before the one who waited for it runs."""

    class Late(ScriptedArm):
        looks = waits = 0

        def check_movable(self) -> None:
            self.looks += 1
            if 1 < self.looks <= 1 + stale:  # the first look is that of the lease
                raise error("STALE_DATA", "arm")

        async def wait_fresh(self, timeout: float) -> None:
            self.waits += 1

    async def main() -> None:
        arm = Late()
        async with bench_with(arm) as bench:
            with suppress(CellError, TimeoutError):
                async with bench.lease() as lease, asyncio.timeout(1.0):
                    await lease.move_joints(np.zeros(6))
            assert arm.waits == 3
            told = [line.get("event") for line in bench.notes.lines]
            assert ("move_joints" in told) is moves

    run_virtual(main())


def test_the_arm_is_lent_to_one_at_a_time() -> None:
    async def main() -> None:
        async with bench_with(ScriptedArm()) as bench, bench.lease():
            with pytest.raises(CellError, match="already holds"):
                await bench.drive()

    run_virtual(main())


def test_a_client_of_ours_from_an_earlier_attempt_is_stopped_when_the_next_one_finds_its_script() -> None:
    """The first attempt started our script; the second is refused because that script still runs."""

    async def main() -> None:
        arm = ScriptedArm({"stop_script"})
        attempts = 0

        async def open_motion(tool: ToolSettings) -> ScriptedArm:
            nonlocal attempts
            attempts += 1
            arm.motion_begun = False
            if attempts > 1:
                raise error("ARM_PROGRAM_RUNNING", "our own script")
            arm.motion_begun = arm.moving = True
            raise error("STALE_DATA", "arm")

        arm.open_motion = open_motion  # type: ignore[method-assign]
        async with bench_with(arm) as bench:
            steps = Interruptions(arm.clock, no_wait, bench.notes.note)
            with pytest.raises(CellError) as refusal:
                async with bench.lease(steps):
                    pass
            assert refusal.value.name == "ARM_PROGRAM_RUNNING"
            assert attempts == 2
            assert bench.notes.standstill_after() == ["stop script"]
            assert not arm.moving

    run_virtual(main())


@pytest.mark.parametrize("losses", [1, 3])
def test_a_motion_client_that_was_opened_just_when_a_device_was_lost_is_not_left_behind(losses: int) -> None:
    """Three in a row end the run; what the last attempt opened is stopped and closed then."""

    class Losing(ScriptedArm):
        opened = 0

        async def open_motion(self, tool: ToolSettings) -> ScriptedArm:
            assert self.asked.count("close") == self.opened, "the one before is still open"
            self.opened += 1
            if self.opened <= losses:
                steps.interrupt(error("DEVICE_LOST", "camera"))
            return self

    async def main() -> None:
        nonlocal steps
        arm = Losing()
        async with bench_with(arm) as bench:
            steps = Interruptions(arm.clock, no_wait, bench.notes.note)
            if losses == 1:
                async with bench.lease(steps):
                    pass
            else:
                with pytest.raises(CellError, match="camera"):
                    async with bench.lease(steps):
                        pass
            assert arm.asked.count("close") == arm.opened == min(losses + 1, 3)
            assert bench.notes.standstill_after()

    steps: Any = None
    run_virtual(main())


@pytest.mark.parametrize("unseen", [False, True])
def test_who_may_have_ended_the_script_unseen_is_asked_about_though_the_link_was_never_lost(
    unseen: bool,
) -> None:
    async def main() -> None:
        arm, asked = ScriptedArm(usable=False, ended_unseen=unseen), list[str]()
        async with bench_with(arm) as bench:
            steps = Interruptions(arm.clock, no_wait, bench.notes.note, ask=asked.append)
            async with bench.lease(steps) as lease:
                await lease.rest()
                await lease.take_up()
        assert arm.asked.count("open") == 2
        assert len(asked) == unseen

    run_virtual(main())


@pytest.mark.parametrize(
    ("moving", "name"), [(False, "STALE_DATA"), (True, "MOTION_NOT_STOPPED")], ids=["at rest", "moving"]
)
def test_states_that_come_back_at_the_end_of_the_wait_are_another_silence_unless_they_show_motion(
    moving: bool, name: str
) -> None:
    async def main() -> None:
        arm = ScriptedArm()
        async with bench_with(arm) as bench, bench.lease() as lease:
            await lease.rest()
            arm.silent, arm.moving = True, moving
            task = asyncio.create_task(lease.take_up())
            await asyncio.sleep(TAKE_UP_REST_S - 0.025)
            arm.silent = False
            with pytest.raises(CellError) as caught:
                await task
            assert caught.value.name == name

    run_virtual(main())


@pytest.mark.parametrize("ours", [True, False])
def test_a_script_of_ours_that_has_still_to_end_is_waited_for_and_one_of_others_is_refused(
    ours: bool,
) -> None:
    class Strict(ScriptedArm):
        async def open_motion(self, tool: ToolSettings) -> ScriptedArm:
            if "open" in self.asked and self.program_running:
                raise error("ARM_PROGRAM_RUNNING", "arm has runtime state 2")
            return await super().open_motion(tool)

    async def end_later(arm: ScriptedArm) -> None:
        await asyncio.sleep(0.4)
        arm.program_running = False

    async def main() -> None:
        arm = Strict(usable=False)
        async with bench_with(arm) as bench, bench.lease() as lease:
            await lease.rest()
            ending = asyncio.create_task(end_later(arm)) if ours else None
            if ours:
                await lease.take_up()
            else:
                with pytest.raises(CellError, match="runtime state 2"):
                    await lease.take_up()
            if ending is not None:
                await ending
            assert arm.asked.count("open") == 1 + ours

    run_virtual(main())


@pytest.mark.parametrize("moment", ["rest", "take_up"])
def test_a_cancel_while_a_motion_client_is_closed_does_not_leave_it_half_closed(moment: str) -> None:
    closed: list[str] = []

    class SlowToClose(ScriptedArm):
        async def close(self) -> None:
            await asyncio.sleep(0.3)
            closed.append(self.name)

    async def main() -> None:
        arm = SlowToClose(hang={"decelerate"} if moment == "rest" else set(), usable=False)
        async with bench_with(arm) as bench, bench.lease() as lease:
            task = asyncio.create_task(getattr(lease, moment)())
            await asyncio.sleep(0.6 if moment == "rest" else 0.15)
            assert closed == []
            task.cancel()
            await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert closed == ["arm"]

    run_virtual(main())


@pytest.mark.parametrize("move", ["joints", "linear", "guarded"])
@pytest.mark.parametrize("happens", ["refuses", "turns"])
def test_an_arm_that_changed_while_its_way_was_checked_does_not_move(move: str, happens: str) -> None:
    def meanwhile() -> None:
        if happens == "refuses":
            arm.refusal = error("ARM_LOCAL_MODE", "while the way was checked")
        else:
            arm.q = np.array([0.0, 0.0, 0.003, 0.0, 0.0, 0.0])
            arm.sample()

    class SlowGuard(OpenGuard):
        def check_path_joints(self, q0: Any, q1: Any) -> None:
            meanwhile()

        def check_path_linear(self, T0: Any, T1: Any, q0: Any, speed_m_s: Any = None) -> None:
            meanwhile()

    arm = ScriptedArm()

    async def main() -> None:
        async with bench_with(arm) as bench, bench.lease(guard=SlowGuard()) as lease:
            there = RigidTransform.identity()
            moves = {
                "joints": lambda: lease.move_joints(TARGET),
                "linear": lambda: lease.move_linear(there),
                "guarded": lambda: lease.guarded_move(there, 10.0, 0.1),
            }
            with pytest.raises(CellError, match=r"while (the way|its path) was checked"):
                await moves[move]()
            assert not arm.moving

    run_virtual(main())


def test_a_joint_move_is_as_fast_as_the_limit_of_each_joint_lets_it_be() -> None:
    told: list[float] = []

    class Arrived(ScriptedArm):
        async def move_joints(self, q: Any, speed: Speed) -> None:
            told.append(speed.joint_rad_s)

    async def main() -> None:
        async with bench_with(Arrived()) as bench, bench.lease() as lease:
            each = replace(SPEED, each_joint_rad_s=(0.2, *[0.8] * 5))
            await lease.move_joints(np.array([0.5, 0.0, 0.0, 0.0, 0.0, 1.0]), each)
            await lease.move_joints(TARGET)

    run_virtual(main())
    assert told == [0.4, 0.8]
