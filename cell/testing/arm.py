"""What every arm promises, on every face: state, identity, motion that is believed only when measured."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from cell.devices import Arm, ArmState, MotionPort, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError
from cell.poses import Array, from_pose6, log_xi, to_pose6
from cell.standstill import measured_standstill
from cell.testing import taken_again
from cell.testing.bench import Bench, Rig, known
from cell.testing.device import DeviceContract

TOOL = ToolSettings(from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]), 1.2)
SPEED = Speed(tcp_m_s=0.25, tcp_m_s2=1.0, joint_rad_s=1.0, joint_rad_s2=3.0)


@dataclass
class ArmRig(Rig[Arm]):
    """An arm that is at rest.

    ``truth()`` gives its true joints (6,) rad, and whether any of them turns, past the driver. ``home`` and
    ``away`` are joints (6,) rad between which the suite may move it, if the bench does not lack ``motion``:
    every straight way between them, and 0.1 m along the tool from either, must be
    free. ``tool`` is set first.
    """

    truth: Callable[[], Awaitable[tuple[Array, bool]]] | None = field(default=None, kw_only=True)
    home: Array | None = field(default=None, kw_only=True)
    away: Array | None = field(default=None, kw_only=True)
    tool: ToolSettings = field(default=TOOL, kw_only=True)


async def fresh(rig: ArmRig) -> ArmState:
    """A state that became true after the call."""
    await rig.device.wait_fresh(3.0)
    return rig.device.state.latest(0.5).value


async def elsewhere(rig: ArmRig) -> Array:
    """Joints a good way from where the arm is; tests that share an arm so stay around one place."""
    q = (await fresh(rig)).q
    return max(
        known(rig.home, "home"), known(rig.away, "away"), key=lambda goal: float(np.max(np.abs(goal - q)))
    )


async def failure_of(work: Coroutine[Any, Any, Any]) -> str:
    """The catalogue name of the error that ``work`` ends with."""
    try:
        await work
    except CellError as exc:
        return exc.name
    return "no error"


async def ends_by(work: Awaitable[str], *names: str) -> None:
    """It ends by one of these errors; an interruption before that plays the scene again."""
    found = await work
    taken_again.interrupted(found, set(names))
    assert found in names


async def start_far_move(rig: ArmRig, port: MotionPort) -> "asyncio.Task[str]":
    """A slow move, well on its way when this returns."""
    slow, goal = Speed(0.1, 0.5, 0.3, 1.0), await elsewhere(rig)
    task = asyncio.create_task(failure_of(port.move_joints(goal, slow)))
    await rig.clock.sleep(0.4)
    assert not (await fresh(rig)).at_rest
    return task


def _shifted(coefficients: Array, t: float) -> Array:
    """The same cubic with its origin moved to ``t``."""
    c0, c1, c2, c3 = coefficients
    return np.array(
        [c0 + c1 * t + c2 * t**2 + c3 * t**3, c1 + 2 * c2 * t + 3 * c3 * t**2, c2 + 3 * c3 * t, c3]
    )


class ArmContract(DeviceContract[ArmRig]):
    """Motion is believed only when it is measured, and each fault has its own name."""

    def test_state_arrives_in_order_on_our_clock_and_without_gaps(self, subject: Bench[ArmRig]) -> None:
        async def scene(rig: ArmRig) -> None:
            start, ages = rig.clock.now(), []
            undo = rig.device.state.subscribe(lambda s: ages.append(rig.clock.now() - s.t))
            async with asyncio.timeout(5.0):
                while len(ages) < 30:
                    await rig.clock.sleep(0.01)
            undo()
            samples = rig.device.state.between(start, rig.clock.now())
            assert len(samples) >= 30
            assert all(a.t <= b.t and a.seq < b.seq for a, b in itertools.pairwise(samples))
            stamps = [s.value.stamp for s in samples]
            assert np.ptp([s.t - stamp for s, stamp in zip(samples, stamps, strict=True)]) < 0.05
            assert np.median(ages) < 0.1

        subject(scene)

    def test_a_resting_arm_is_movable_and_shows_no_fault(self, subject: Bench[ArmRig]) -> None:
        async def scene(rig: ArmRig) -> None:
            rig.device.check_movable()
            assert rig.device.fault() is None
            assert (await fresh(rig)).at_rest
            assert not (await fresh(rig)).program_running
            assert await measured_standstill(rig.device, 2.0)

        subject(scene)

    def test_opening_motion_sets_the_tool_and_closing_it_ends_the_program(
        self,
        subject: Bench[ArmRig],
    ) -> None:
        subject.needs("motion")

        async def scene(rig: ArmRig) -> None:
            flange, epoch = (await fresh(rig)).T_base_flange, rig.device.state.epoch
            port = await rig.device.open_motion(rig.tool)
            seen = await fresh(rig)
            assert rig.device.state.epoch > epoch, "TCP poses before and after do not compare"
            assert np.allclose(seen.tcp_offset6, to_pose6(rig.tool.T_flange_tool), atol=1e-6)
            assert np.allclose(log_xi(flange.inv() * seen.T_base_flange), 0.0, atol=1e-6)
            assert seen.program_running
            await ends_by(failure_of(rig.device.open_motion(rig.tool)), "MOTION_BUSY")
            await port.close()
            await rig.clock.sleep(0.3)
            assert not (await fresh(rig)).program_running

        subject(scene)

    def test_another_tool_can_be_set_while_a_port_is_open(self, subject: Bench[ArmRig]) -> None:
        subject.needs("motion")

        async def scene(rig: ArmRig) -> None:
            other = ToolSettings(from_pose6([0.001, -0.002, 0.17, 0.01, 0.0, 0.0]), 0.8)
            port = await rig.device.open_motion(rig.tool)
            flange, epoch = (await fresh(rig)).T_base_flange, rig.device.state.epoch
            await port.set_tool(other)
            seen = await fresh(rig)
            assert rig.device.state.epoch > epoch
            assert np.allclose(seen.tcp_offset6, to_pose6(other.T_flange_tool), atol=1e-6)
            assert np.allclose(log_xi(flange.inv() * seen.T_base_flange), 0.0, atol=1e-6)
            goal = flange * from_pose6([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
            await port.move_linear(goal, SPEED)
            assert np.max(np.abs(log_xi(goal.inv() * (await fresh(rig)).T_base_flange))) < 0.001
            await port.close()

        subject(scene)

    def test_a_joint_move_returns_when_the_measured_joints_agree(self, subject: Bench[ArmRig]) -> None:
        subject.needs("motion", "truth")

        async def scene(rig: ArmRig) -> None:
            port = await rig.device.open_motion(rig.tool)
            goal = await elsewhere(rig)
            await port.move_joints(goal, SPEED)
            assert np.max(np.abs((await fresh(rig)).q - goal)) < 0.001
            assert np.max(np.abs((await known(rig.truth, "truth")())[0] - goal)) < 0.001
            await port.close()

        subject(scene)

    def test_a_linear_move_keeps_the_tool_on_the_line(self, subject: Bench[ArmRig]) -> None:
        subject.needs("motion")

        async def scene(rig: ArmRig) -> None:
            port = await rig.device.open_motion(rig.tool)
            start, began = (await fresh(rig)), rig.clock.now()
            goal = start.T_base_flange * from_pose6([0.06, -0.04, -0.1, 0.0, 0.2, 0.1])
            await port.move_linear(goal, SPEED)
            assert np.max(np.abs(log_xi(goal.inv() * (await fresh(rig)).T_base_flange))) < 0.001
            tips = np.array([s.value.tcp_pose6[:3] for s in rig.device.state.between(began, rig.clock.now())])
            way = (goal * rig.tool.T_flange_tool).translation - start.tcp_pose6[:3]
            off = np.cross(tips - start.tcp_pose6[:3], way / np.linalg.norm(way))
            assert len(tips) > 10
            assert np.max(np.linalg.norm(off, axis=1)) < 2e-4
            await port.close()

        subject(scene)

    def test_a_stream_of_polynomials_is_followed_and_ends_at_rest(self, subject: Bench[ArmRig]) -> None:
        subject.needs("motion")

        async def scene(rig: ArmRig) -> None:
            port = await rig.device.open_motion(rig.tool)
            q0 = (await fresh(rig)).q
            total, change = 1.0, 0.5 * (await elsewhere(rig) - q0)

            async def pieces() -> AsyncIterator[TrajectoryPiece]:
                begin = rig.clock.now() + 0.1
                coefficients = np.array([q0, 0 * q0, 3 * change / total**2, -2 * change / total**3])
                for t in np.arange(0.0, total, 0.1):
                    yield TrajectoryPiece(begin + t, begin + t + 0.1, _shifted(coefficients, t))

            await port.stream(pieces())
            assert np.max(np.abs((await fresh(rig)).q - q0 - change)) < 0.003
            assert await measured_standstill(rig.device, 2.0)
            await port.close()

        subject(scene)

    def test_decelerating_ends_a_move_short_of_its_target(self, subject: Bench[ArmRig]) -> None:
        subject.needs("motion")

        async def scene(rig: ArmRig) -> None:
            port = await rig.device.open_motion(rig.tool)
            await port.decelerate()
            goal = await elsewhere(rig)
            moving = await start_far_move(rig, port)
            await port.decelerate()
            assert await measured_standstill(rig.device, 1.0)
            await ends_by(moving, "ARM_NOT_AT_TARGET")
            assert np.max(np.abs((await fresh(rig)).q - goal)) > 0.05
            await port.close()

        subject(scene)

    @pytest.mark.parametrize("step", ["stop_script", "stop_program"])
    def test_each_step_of_the_stop_ladder_stops_a_moving_arm(self, subject: Bench[ArmRig], step: str) -> None:
        subject.needs("motion")

        async def scene(rig: ArmRig) -> None:
            port = await rig.device.open_motion(rig.tool)
            moving = await start_far_move(rig, port)
            await getattr(rig.device, step)()
            assert await measured_standstill(rig.device, 1.5)
            assert await moving != "no error"
            await port.close()

        subject(scene)

    @pytest.mark.parametrize(
        ("fault", "named"),
        [
            ("protective-stop", {"ARM_PROTECTIVE_STOP"}),
            ("emergency-stop", {"ARM_EMERGENCY_STOP"}),
            ("safeguard-stop", {"ARM_SAFEGUARD_STOP"}),
            ("local-mode", {"ARM_LOCAL_MODE", "ARM_SCRIPT_DIED"}),
            ("script-death", {"ARM_SCRIPT_DIED"}),
            ("foreign-program", {"ARM_PROGRAM_RUNNING", "ARM_SCRIPT_DIED"}),
            ("silence", {"STALE_DATA", "DEVICE_LOST"}),
            ("drop", {"DEVICE_LOST"}),
        ],
    )
    def test_a_fault_ends_a_move_with_its_own_error_and_the_arm_comes_to_rest(
        self, subject: Bench[ArmRig], fault: str, named: set[str]
    ) -> None:
        subject.needs("motion", "truth", fault)

        async def scene(rig: ArmRig) -> None:
            port = await rig.device.open_motion(rig.tool)
            moving = await start_far_move(rig, port)
            await rig.inject(fault)
            await ends_by(moving, *named)
            await failure_of(port.decelerate())
            await failure_of(port.close())
            await rig.clock.sleep(0.8)
            assert not (await known(rig.truth, "truth")())[1]

        subject(scene)

    @pytest.mark.parametrize(
        ("fault", "named"),
        [
            ("protective-stop", "ARM_PROTECTIVE_STOP"),
            ("emergency-stop", "ARM_EMERGENCY_STOP"),
            ("safeguard-stop", "ARM_SAFEGUARD_STOP"),
            ("local-mode", "ARM_LOCAL_MODE"),
            ("foreign-program", "ARM_PROGRAM_RUNNING"),
            ("register-in-use", "ARM_REGISTER_CONFLICT"),
        ],
    )
    def test_motion_is_refused_while_the_arm_may_not_move_and_granted_again_afterwards(
        self, subject: Bench[ArmRig], fault: str, named: str
    ) -> None:
        subject.needs("motion", fault)

        async def scene(rig: ArmRig) -> None:
            before = (await fresh(rig)).q
            await rig.inject(fault)
            await rig.clock.sleep(0.5)
            await ends_by(failure_of(rig.device.open_motion(rig.tool)), named)
            assert np.allclose((await fresh(rig)).q, before, atol=1e-4)
            await rig.inject("clear")
            await rig.clock.sleep(0.5)
            port = await rig.device.open_motion(rig.tool)
            await port.close()

        subject(scene)

    def test_a_dropped_link_is_told_and_can_be_opened_again(self, subject: Bench[ArmRig]) -> None:
        subject.needs("drop")

        async def scene(rig: ArmRig) -> None:
            waiting = asyncio.create_task(rig.device.wait_lost())
            await rig.clock.sleep(0.05)
            epoch = rig.device.state.epoch
            await rig.inject("drop")
            async with asyncio.timeout(3.0):
                assert getattr(await waiting, "name", None) == "DEVICE_LOST"
            with pytest.raises(CellError):
                rig.device.check_movable()
            await rig.device.close()
            await rig.device.open()
            await rig.device.wait_fresh(2.0)
            assert rig.device.state.epoch > epoch
            rig.device.check_movable()

        subject(scene)
