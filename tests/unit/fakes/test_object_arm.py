"""The arm of the object face beyond the common contract: faults, watchdog, laziness, determinism."""

import asyncio
import gc
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import aclosing
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.clock import Clock
from cell.devices import ArmState, MotionPort, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError
from cell.motion import MotionBroker
from cell.poses import from_pose6
from cell.samples import Sample
from fakes.object import ObjectArm, VirtualClock, cell_of, run_virtual, world_of
from tests.kit.ideal_world import ideal_text

TOOL = ToolSettings(from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]), 1.2)
SLOW = Speed(0.1, 0.5, 0.2, 1.0)

Scene = Callable[[ObjectArm], Coroutine[Any, Any, Any]]


def arm_on(clock: Clock, scenario: str = "hand_eye:ideal", **settings: Any) -> ObjectArm:
    return ObjectArm("arm", ObjectArm.Config(scenario=scenario, **settings), clock)


@pytest.fixture
def subject() -> Callable[[Scene], Any]:
    def play(scene: Scene) -> Any:
        async def whole() -> Any:
            arm = arm_on(VirtualClock())
            await arm.open()
            try:
                return await scene(arm)
            finally:
                await arm.close()

        return run_virtual(whole())

    return play


async def failure_of(work: Awaitable[Any]) -> str:
    try:
        await work
    except CellError as exc:
        return exc.name
    return "no error"


def moving(arm: ObjectArm) -> bool:
    return bool(np.any(arm.world.track.at(arm.clock.now())[1]))


async def start_move(arm: ObjectArm, port: MotionPort) -> "asyncio.Task[str]":
    task = asyncio.create_task(failure_of(port.move_joints(arm.state.latest(0.1).value.q + 0.5, SLOW)))
    await arm.clock.sleep(0.5)
    assert moving(arm)
    return task


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        ("register-in-use", "ARM_REGISTER_CONFLICT"),
        ("foreign-program", "ARM_PROGRAM_RUNNING"),
        ("local-mode", "ARM_LOCAL_MODE"),
        ("child-crash", "CHILD_DIED"),
        ("watchdog", "MOTION_WATCHDOG"),
        ("stall", "ARM_NOT_AT_TARGET"),
        ("silence", "STALE_DATA"),
        ("refuse", "DEVICE_LOST"),
        ("reboot", "ARM_REBOOTED"),
    ],
)
def test_each_fault_ends_a_move_with_its_own_error(
    subject: Callable[[Scene], Any], fault: str, named: str
) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        move = await start_move(arm, port)
        arm.inject(fault)
        assert await move == named
        await failure_of(port.close())
        await arm.clock.sleep(0.5)
        assert not moving(arm)

    subject(scene)


def test_a_port_is_dead_after_a_fault_even_when_the_fault_is_over(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        move = await start_move(arm, port)
        arm.inject("protective-stop")
        await move
        arm.inject("clear")
        before = arm.world.track.at(arm.clock.now())[0]
        assert await failure_of(port.move_joints(before + 0.1, SLOW)) == "ARM_PROTECTIVE_STOP"
        await arm.clock.sleep(1.0)
        assert np.max(np.abs(arm.world.track.at(arm.clock.now())[0] - before)) < 0.02
        await port.close()

    subject(scene)


def test_a_port_that_is_left_without_close_stops_the_arm_after_the_watchdog_time(
    subject: Callable[[Scene], Any],
) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        arm.world.track.speed_joints(arm.clock.now(), np.full(6, 0.1), 1.0)
        await arm.clock.sleep(0.5)
        del port
        gc.collect()
        await arm.clock.sleep(0.19)
        assert moving(arm)
        await arm.clock.sleep(0.11)
        assert not moving(arm)
        assert not arm.state.latest(0.1).value.program_running

    subject(scene)


def test_a_dropped_link_leaves_the_arm_to_the_watchdog(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        await start_move(arm, port)
        arm.inject("drop")
        assert await failure_of(port.decelerate()) == "DEVICE_LOST"
        await arm.clock.sleep(0.19)
        assert moving(arm)
        await arm.clock.sleep(0.15)
        assert not moving(arm)

    subject(scene)


def test_a_call_that_hangs_can_be_cancelled_and_the_next_one_works(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        arm.inject("hang")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(100.0):
                await port.move_joints(arm.state.latest(0.1).value.q + 0.1, SLOW)
        await port.move_joints(arm.state.latest(0.1).value.q + 0.1, SLOW)
        await port.close()

    subject(scene)


def test_a_reboot_comes_back_off_and_with_the_identity_asked_for(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        arm.inject("reboot", serial="99990000042", boot_s=5.0)
        assert (await arm.wait_lost()).name == "ARM_REBOOTED"  # type: ignore[attr-defined]
        assert await failure_of(arm.open()) == "DEVICE_UNREACHABLE"
        await arm.clock.sleep(5.0)
        await arm.open()
        assert (await arm.identify()).serial == "99990000042"
        assert await failure_of(arm.open_motion(TOOL)) == "ARM_REBOOTED"
        assert arm.state.latest(0.1).value.stamp < 1.0
        arm.inject("clear")
        await arm.wait_fresh(1.0)
        await (await arm.open_motion(TOOL)).close()

    subject(scene)


def test_an_arm_with_another_serial_than_expected_is_refused() -> None:
    async def scene() -> None:
        arm = arm_on(VirtualClock(), expect_serial="99990000001")
        await arm.open()
        assert await failure_of(arm.identify()) == "DEVICE_IDENTITY"
        await arm.close()

    run_virtual(scene())


def test_a_short_silence_is_a_gap_and_not_a_loss(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        unsubscribe = arm.state.subscribe(lambda sample: None)
        await arm.clock.sleep(0.1)
        arm.inject("silence", duration_s=0.06)
        await arm.clock.sleep(0.2)
        assert arm.lost is None
        assert arm.state.gaps in (5, 6)
        arm.inject("gap", count=3)
        await arm.clock.sleep(0.1)
        assert arm.state.gaps in (8, 9)
        unsubscribe()

    subject(scene)


def test_a_port_that_was_blind_for_a_while_is_not_used_again(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        move = await start_move(arm, port)
        arm.inject("silence", duration_s=0.08)
        assert await move == "STALE_DATA"
        await port.decelerate()
        await arm.clock.sleep(0.5)
        assert arm.lost is None
        assert not moving(arm)
        assert await failure_of(port.move_joints(arm.state.latest(0.1).value.q, SLOW)) == "STALE_DATA"
        await port.close()

    subject(scene)


@pytest.mark.parametrize("left_s", [0.05, 0.15, 0.25])
def test_a_stop_does_not_carry_a_brisk_move_past_its_end(
    subject: Callable[[Scene], Any], left_s: float
) -> None:
    brisk = Speed(1.0, 10.0, 3.0, 20.0)

    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        start = arm.state.latest(0.1).value.q
        goal = start + np.array([1.2, 0.3, 0.0, 0.0, 0.0, 0.0])
        move = asyncio.create_task(failure_of(port.move_joints(goal, brisk)))
        await arm.clock.sleep(1.2 / 3.0 + 3.0 / 20.0 - left_s)
        assert moving(arm)
        await port.decelerate()
        await arm.clock.sleep(0.5)
        assert not moving(arm)
        q = arm.state.latest(0.1).value.q
        assert start[0] < q[0] < goal[0] + 1e-3
        assert abs((q[1] - start[1]) / 0.3 - (q[0] - start[0]) / 1.2) < 2e-3
        await move
        await port.close()

    subject(scene)


def test_a_safeguard_that_closes_again_lets_the_next_port_move(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        arm.inject("safeguard-stop", duration_s=2.0)
        assert await failure_of(arm.open_motion(TOOL)) == "ARM_SAFEGUARD_STOP"
        await arm.clock.sleep(2.1)
        await (await arm.open_motion(TOOL)).close()

    subject(scene)


def test_unknown_faults_and_arguments_are_refused_with_what_there_is(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        with pytest.raises(CellError, match="protective-stop"):
            arm.inject("earthquake")
        with pytest.raises(CellError, match="seconds"):
            arm.inject("drop", seconds=3)

    subject(scene)


def test_nobody_reading_costs_no_samples_and_a_reader_gets_those_that_were_due(
    subject: Callable[[Scene], Any],
) -> None:
    async def scene(arm: ObjectArm) -> None:
        await arm.clock.sleep(3600.0)
        now = arm.clock.now()
        assert [s.t for s in arm.state.between(now - 0.1, now)] == pytest.approx(
            np.arange(now - 0.1, now + 1e-9, 0.01), abs=0.0101
        )
        assert arm.state.received < 500
        assert arm.state.gaps == 0

    subject(scene)


def test_samples_made_late_show_the_past_as_it_was(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        await arm.clock.sleep(0.5)
        stopped = arm.clock.now()
        arm.inject("protective-stop")
        await arm.clock.sleep(0.5)
        modes = {
            (s.t > stopped, s.value.safety_mode) for s in arm.state.between(stopped - 0.4, stopped + 0.4)
        }
        assert modes == {(False, 1), (True, 3)}

    subject(scene)


@pytest.mark.parametrize("scenario", ["hand_eye:ideal", "hand_eye"])
def test_samples_tell_what_the_arm_did_bit_by_bit_whatever_was_planned_before(scenario: str) -> None:
    async def scene() -> None:
        arm = arm_on(VirtualClock(), scenario)
        await arm.open()
        world, samples = arm.world, list[Sample[ArmState]]()
        arm.state.subscribe(samples.append)
        q = world.track.at(arm.clock.now())[0]
        for k in range(4):
            now = arm.clock.now()
            world.track.start_joint_move(now, q + 0.3 * (-1) ** k, 0.5, 2.0)
            await arm.clock.sleep(0.437)
            now = arm.clock.now()
            line = world.believed_flange(now)
            goal = RigidTransform.from_translation([0.0, 0.02, 0.01]) * line
            await arm.clock.sleep(world.track.stop_joint(now, 3.0) - now)
            await arm.take_tool(ToolSettings(from_pose6([0.0, 0.01 * k, 0.18, 0.1, 0.0, 0.0]), 1.2))
            world.track.start_linear_move(
                arm.clock.now(), world.believed, goal, RigidTransform.identity(), 0.1, 0.5
            )
            await arm.clock.sleep(0.523)
            world.track.halt(arm.clock.now(), 5.0)
            await arm.clock.sleep(0.3)
            for sample in samples:
                state = sample.value
                q_true, qd_true = world.reported.joints(sample.t, *world.track.at(sample.t))
                assert np.array_equal(state.q, q_true)
                assert np.array_equal(state.qd, qd_true)
                told = world.believed.matrix(q_true) @ from_pose6(state.tcp_offset6).as_matrix()
                assert from_pose6(state.tcp_pose6).as_matrix() == pytest.approx(told, abs=1e-14)
            assert len(samples) > 100
            samples.clear()
        await arm.close()

    run_virtual(scene())


def test_samples_of_an_arm_at_rest_differ_by_their_stamp_alone(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        arm.inject("speed-slider", fraction=0.5)
        await arm.clock.sleep(0.5)
        first, *others = (s.value for s in arm.state.between(arm.clock.now() - 0.1, arm.clock.now()))
        names = [field.name for field in fields(ArmState)]
        assert len(others) > 1
        assert first.speed_scaling == 0.5
        for other in others:
            differ = [n for n in names if not np.array_equal(getattr(first, n), getattr(other, n))]
            assert differ == ["stamp"]

    subject(scene)


def test_two_runs_give_the_same_samples_bit_by_bit() -> None:
    def run() -> list[bytes]:
        async def scene() -> list[bytes]:
            arm = arm_on(VirtualClock())
            await arm.open()
            port = await arm.open_motion(TOOL)
            begin = arm.clock.now()
            await port.move_joints(arm.state.latest(0.1).value.q + 0.2, SLOW)
            await port.close()
            samples = arm.state.between(begin, arm.clock.now())
            true = [arm.world.true_flange(s.t).as_matrix().tobytes() for s in samples]
            await arm.close()
            return [s.value.q.tobytes() for s in samples] + true

        return run_virtual(scene())

    first = run()
    assert len(first) > 200
    assert first == run()


def test_devices_of_one_scenario_and_clock_share_a_world_and_other_clocks_do_not() -> None:
    clock = VirtualClock()
    assert arm_on(clock).world is world_of("hand_eye:ideal", clock)
    assert cell_of("hand_eye:ideal", clock).world is world_of("hand_eye:ideal", clock)
    assert world_of("hand_eye:ideal", VirtualClock()) is not world_of("hand_eye:ideal", clock)


def test_a_fault_of_the_scenario_happens_at_its_time(tmp_path: Path) -> None:
    text = ideal_text("hand_eye")
    path = tmp_path / "stop.toml"
    path.write_text(text + '[[fault]]\ndevice = "arm"\nkind = "protective-stop"\nwhen_s = 2.0\n', "utf-8")

    async def scene() -> None:
        arm = arm_on(VirtualClock(), str(path))
        await arm.open()
        await arm.clock.sleep(1.9)
        assert arm.fault() is None
        await arm.clock.sleep(0.2)
        assert getattr(arm.fault(), "name", None) == "ARM_PROTECTIVE_STOP"
        await arm.close()

    run_virtual(scene())


async def two_pieces(arm: ObjectArm, late_s: float) -> AsyncIterator[TrajectoryPiece]:
    q0 = arm.state.latest(0.1).value.q
    begin = arm.clock.now()
    ramp = np.array([q0, 0 * q0, np.full(6, 0.2)])
    yield TrajectoryPiece(begin, begin + 0.5, ramp)
    await arm.clock.sleep(late_s)
    yield TrajectoryPiece(begin + 0.5, begin + 1.0, ramp)


def test_a_stream_that_is_not_renewed_in_time_ends_in_a_ramp_and_says_so(
    subject: Callable[[Scene], Any],
) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        assert await failure_of(port.stream(two_pieces(arm, late_s=5.0))) == "MOTION_WATCHDOG"
        assert not moving(arm)
        assert arm.clock.now() < 1003.0
        await port.close()

    subject(scene)


def test_a_stream_that_begins_elsewhere_is_refused(subject: Callable[[Scene], Any]) -> None:
    async def scene(arm: ObjectArm) -> None:
        port = await arm.open_motion(TOOL)
        q = arm.state.latest(0.1).value.q

        async def jump() -> AsyncGenerator[TrajectoryPiece, None]:
            yield TrajectoryPiece(arm.clock.now(), arm.clock.now() + 0.1, np.array([q + 0.3]))

        async with aclosing(jump()) as pieces:  # as a lease does
            assert await failure_of(port.stream(pieces)) == "MOTION_LIMIT"
        assert not moving(arm)
        await port.close()

    subject(scene)


def test_a_guarded_move_ends_at_the_force_or_at_the_travel_limit(tmp_path: Path) -> None:
    text = ideal_text("hand_eye")
    tip = (world_of("hand_eye:ideal", VirtualClock()).believed_flange(0.0) * TOOL.T_flange_tool).translation
    wall = f"[[world.obstacle]]\npoint = [0, 0, {tip[2] - 0.03}]\nnormal = [0, 0, 1]\nstiffness_n_m = 5000\n"
    path = tmp_path / "table.toml"
    path.write_text(text.replace("[fakes]", wall + "[fakes]"), "utf-8")

    async def scene() -> None:
        arm = arm_on(VirtualClock(), str(path))
        await arm.open()
        port = await arm.open_motion(TOOL)
        down = arm.state.latest(0.1).value.T_base_flange * from_pose6([0, 0, 0.08, 0, 0, 0])
        careful = Speed(0.02, 0.5, 0.5, 1.0)
        assert await port.guarded_move(down, careful, max_force_n=10.0, max_travel_m=0.02) is False
        assert tip[2] - arm.state.latest(0.1).value.tcp_pose6[2] == pytest.approx(0.02, abs=5e-4)
        assert await port.guarded_move(down, careful, max_force_n=10.0, max_travel_m=0.05) is True
        reached = arm.state.latest(0.1).value
        # 10 N at 5 N/mm is 2 mm deep; 20 mm/s and one look each 2 ms add a little.
        assert tip[2] - reached.tcp_pose6[2] == pytest.approx(0.032, abs=3e-4)
        assert 9.5 < reached.tcp_force[2] < 12.0
        await port.close()
        await arm.close()

    run_virtual(scene())


@pytest.mark.parametrize(("limit_n", "ended"), [(2.0, True), (20.0, False)])
def test_a_guarded_move_ends_at_a_force_that_only_wanders_where_the_limit_is_near_it(
    limit_n: float, ended: bool
) -> None:
    async def scene() -> None:
        arm = arm_on(VirtualClock(), "hand_eye")
        await arm.open()
        port = await arm.open_motion(TOOL)
        start = arm.state.latest(0.1).value
        down = start.T_base_flange * from_pose6([0, 0, 0.08, 0, 0, 0])
        slow = Speed(0.01, 0.5, 0.5, 1.0)
        assert await port.guarded_move(down, slow, max_force_n=limit_n, max_travel_m=0.08) is ended
        wandered = arm.state.latest(0.1).value.tcp_force - start.tcp_force
        assert 1.5 < np.linalg.norm(wandered[:3]) < 20.0
        await port.close()
        await arm.close()

    run_virtual(scene())


class FreeRoom:
    """A guard with nothing to object to."""

    def check_path_joints(self, q0: Any, q1: Any) -> None: ...
    def check_path_linear(self, T0: Any, T1: Any, q0: Any, speed_m_s: Any = None) -> None: ...
    def check_setpoints(self, Q: Any, Qd: Any) -> None: ...


class Notes(list[dict[str, Any]]):
    def note(self, kind: str, **fields: Any) -> None:
        self.append({"kind": kind, **fields})


@pytest.mark.parametrize("fault", [None, "protective-stop", "script-death", "stall", "child-crash", "hang"])
def test_a_lease_on_this_arm_ends_in_measured_standstill(
    subject: Callable[[Scene], Any], fault: str | None
) -> None:
    async def scene(arm: ObjectArm) -> None:
        broker, notes = MotionBroker(arm.clock), Notes()

        async def job() -> None:
            async with broker.lease(arm, FreeRoom(), TOOL, SLOW, notes) as lease:
                await lease.move_joints(arm.state.latest(0.1).value.q + 0.5)

        task = asyncio.create_task(job())
        await arm.clock.sleep(0.8)
        assert moving(arm)
        if fault is not None:
            arm.inject(fault)
        task.cancel()
        await asyncio.wait([task])
        assert not moving(arm)
        assert notes[-1]["event"] == "standstill"
        assert broker.latched is None

    subject(scene)
