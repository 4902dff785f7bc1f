"""The gripper against a controller on the wire; the genuine client writes and reads the same outputs."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from ur_driver_rig import Rig, until

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.testing.taken_again import play
from drivers.ur.gripper import ArmGripper
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.one_item import one_item_under_the_tool

pytestmark = pytest.mark.wire
CLOSES, HOLDS = 0, 7  # output and confirm input of the scenario


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    path = tmp_path_factory.mktemp("gripper") / "scenario.toml"
    path.write_text(one_item_under_the_tool(), "utf-8")
    with Rig.running(scenario=path) as made:
        yield made


@asynccontextmanager
async def gripper(rig: Rig, **config: Any) -> AsyncIterator[ArmGripper]:
    async with rig.connected() as arm:
        wired = {"output": CLOSES, "confirm": HOLDS} | config
        subject = ArmGripper("gripper", ArmGripper.Config(**wired), MonotonicClock())
        subject.bind(arm)
        await subject.open()
        try:
            await arm.wait_fresh(1.0)
            yield subject
        finally:
            await subject.close()


class Genuine:
    """The controller's digital outputs as the genuine client reads them. Its construction and its end hold
    the interpreter lock, so it lives as long as the module."""

    def __init__(self, host: str) -> None:
        from rtde_receive import RTDEReceiveInterface

        self.client = RTDEReceiveInterface(host)

    async def reads(self, *on: int) -> None:
        """Wait until just these outputs are on."""
        wanted = sum(1 << k for k in on)
        await until(lambda: self.client.getActualDigitalOutputBits() == wanted)


@pytest.fixture(scope="module")
def genuine(rig: Rig) -> Iterator[Genuine]:
    made = Genuine(rig.host)
    yield made
    made.client.disconnect()


def test_fingers_that_close_on_an_item_confirm_it_and_nothing_is_confirmed_without_one(
    rig: Rig, genuine: Genuine
) -> None:
    async def scene() -> None:
        async with gripper(rig) as subject:
            assert not subject.holding(0.1)
            assert await subject.grip(1.0), "the item lies between the fingers"
            assert subject.holding(0.1)
            await genuine.reads(CLOSES)
            assert await subject.release(1.0)
            assert not subject.holding(0.1)
            await genuine.reads()
            assert not await subject.grip(0.2), "the item is gone"
            assert subject.health() == {"connected": True, "closed": True, "holding": False}
            assert await subject.release(0.2)

    asyncio.run(scene())


@pytest.mark.parametrize(("silent_s", "told"), [(0.15, None), (0.4, "STALE_DATA")])
def test_an_arm_that_is_silent_for_a_moment_is_not_taken_for_a_gripper_that_does_not_follow(
    rig: Rig, silent_s: float, told: str | None
) -> None:
    async def scene() -> None:
        async with gripper(rig) as subject:
            rig.inject("silence", for_s=silent_s)
            if told is None:
                assert await subject.release(0.1)
            else:
                with pytest.raises(CellError) as failure:
                    await subject.release(0.1)
                assert failure.value.name == told

    play(scene)


def test_opening_and_closing_the_link_leave_the_output_as_somebody_else_set_it(
    rig: Rig, genuine: Genuine
) -> None:
    from rtde_io import RTDEIOInterface

    writer = RTDEIOInterface(rig.host)
    assert writer.setStandardDigitalOut(CLOSES, True)
    assert writer.setStandardDigitalOut(3, True)
    writer.disconnect()

    async def scene() -> None:
        async with gripper(rig) as subject:
            await until(lambda: subject.health()["closed"] is True)
        await genuine.reads(CLOSES, 3)
        async with gripper(rig) as subject:
            await subject.release(0.5)
        await genuine.reads(3)

    asyncio.run(scene())


def test_outputs_that_another_client_has_are_told_as_a_conflict_and_ours_are_refused_to_it(rig: Rig) -> None:
    from rtde_io import RTDEIOInterface

    async def conflict() -> CellError:
        with pytest.raises(CellError) as caught:
            async with gripper(rig):
                pass
        return caught.value

    async def refused() -> None:
        async with gripper(rig):
            with pytest.raises(RuntimeError, match=r"(?i)in use"):
                await asyncio.to_thread(RTDEIOInterface, rig.host)

    other = RTDEIOInterface(rig.host)
    failure = asyncio.run(conflict())
    other.disconnect()
    assert failure.name == "ARM_REGISTER_CONFLICT"
    assert "standard_digital_output" in str(failure)
    asyncio.run(refused())


@pytest.mark.parametrize("output", [2, 9, 17])
def test_each_output_is_written_in_its_own_bank(rig: Rig, genuine: Genuine, output: int) -> None:
    async def scene() -> None:
        async with gripper(rig, output=output) as subject:
            before = [k for k in range(18) if genuine.client.getActualDigitalOutputBits() >> k & 1]
            assert output not in before
            await subject.grip(0.05)
            await genuine.reads(*before, output)
            await subject.release(0.05)
            await genuine.reads(*before)

    asyncio.run(scene())


def test_a_single_item_lies_in_this_modules_world() -> None:
    world = World.from_scenario(Scenario.parse(one_item_under_the_tool()))
    assert world.items is not None
    assert world.items.numbers(1.0, -1.0, 1.0) == [0]


OPENS = 1  # with a valve of two coils, or what blows a vacuum off


@pytest.fixture(scope="module")
def valve(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A gripper with a second output, and no input that confirms."""
    path = tmp_path_factory.mktemp("valve") / "scenario.toml"
    text = one_item_under_the_tool().replace(f"confirm = {HOLDS}", f"open_output = {OPENS}")
    path.write_text(text, "utf-8")
    with Rig.running(scenario=path) as made:
        yield made


def test_a_gripper_that_nobody_confirms_is_given_the_time_that_it_takes(valve: Rig) -> None:
    async def scene() -> None:
        keys = {"confirm": None, "open_output": OPENS, "moves_s": 0.1, "blow_off_s": 0.2}
        async with gripper(valve, **keys) as subject:
            word = subject._arm.state.last
            begun = subject._clock.now()
            assert await subject.grip(1.0)
            assert subject._clock.now() - begun >= 0.1
            assert subject.holding(0.1)
            assert word().value.digital_out == 1 << CLOSES
            releasing = asyncio.create_task(subject.release(1.0))
            await until(lambda: word().value.digital_out == 1 << OPENS)
            assert await releasing
            await until(lambda: word().value.digital_out == 0)
            assert not subject.holding(0.1)
            with pytest.raises(CellError, match=r"moves_s is 0\.1 s, and the timeout is 0\.05 s"):
                await subject.grip(0.05)

    asyncio.run(scene())
