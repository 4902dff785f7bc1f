"""What every gripper promises, on every face."""

import asyncio
from dataclasses import dataclass

import pytest

from cell.devices import Gripper
from cell.errors import CellError
from cell.testing.bench import Bench, Rig
from cell.testing.device import DeviceContract

MOVES_S = 3.0  # far longer than fingers take to close or open
AT_ONCE_S = 0.001
FRESH_S = 1.0


@dataclass
class GripperRig(Rig[Gripper]):
    """A gripper that is open and holds nothing.

    A bench makes it with the option ``part``: whether there is something between its fingers.
    """

    async def holds(self, wanted: bool) -> None:
        """Wait until the gripper says so of itself."""
        async with asyncio.timeout(MOVES_S):
            while self.device.holding(FRESH_S) is not wanted:
                await self.clock.sleep(0.02)


class GripperContract(DeviceContract[GripperRig]):
    """What is held is what was measured, and only a command moves the fingers."""

    def test_it_says_whether_anything_confirms_its_grip(self, subject: Bench[GripperRig]) -> None:
        async def scene(rig: GripperRig) -> None:
            assert isinstance(rig.device.confirms, bool)

        subject(scene)

    def test_it_takes_and_lets_go_and_says_what_it_holds(self, subject: Bench[GripperRig]) -> None:
        subject.needs("part")

        async def scene(rig: GripperRig) -> None:
            assert not rig.device.holding(FRESH_S)
            assert await rig.device.grip(MOVES_S)
            assert rig.device.holding(FRESH_S)
            assert await rig.device.release(MOVES_S)
            assert not rig.device.holding(FRESH_S)

        subject(scene, part=True)

    def test_fingers_that_close_on_nothing_hold_nothing_where_anything_tells(
        self, subject: Bench[GripperRig]
    ) -> None:
        subject.needs("part")

        async def scene(rig: GripperRig) -> None:
            told = await rig.device.grip(MOVES_S)
            assert told is not rig.device.confirms
            assert rig.device.holding(FRESH_S) is not rig.device.confirms
            assert await rig.device.release(MOVES_S)

        subject(scene, part=False)

    def test_what_takes_longer_than_was_waited_for_is_told_as_not_held_yet(
        self, subject: Bench[GripperRig]
    ) -> None:
        subject.needs("part")

        async def scene(rig: GripperRig) -> None:
            if rig.device.confirms:
                assert not await rig.device.grip(AT_ONCE_S)
            else:  # when it has closed is told beforehand, and that it cannot be by then
                with pytest.raises(CellError) as caught:
                    await rig.device.grip(AT_ONCE_S)
                assert caught.value.name == "ARGUMENT_INVALID"
            await rig.holds(True)
            assert await rig.device.release(MOVES_S)

        subject(scene, part=True)

    def test_neither_closing_the_link_nor_opening_it_lets_anything_fall(
        self, subject: Bench[GripperRig]
    ) -> None:
        subject.needs("part")

        async def scene(rig: GripperRig) -> None:
            assert await rig.device.grip(MOVES_S)
            await rig.device.close()
            await rig.clock.sleep(0.5)
            await rig.device.open()
            await rig.holds(True)
            assert await rig.device.release(MOVES_S)

        subject(scene, part=True)

    def test_a_closed_gripper_neither_moves_nor_says_what_it_holds(self, subject: Bench[GripperRig]) -> None:
        async def scene(rig: GripperRig) -> None:
            await rig.device.close()
            with pytest.raises(CellError) as caught:
                rig.device.holding(FRESH_S)
            assert caught.value.name == "DEVICE_LOST"
            for refused in (rig.device.grip(MOVES_S), rig.device.release(MOVES_S)):
                with pytest.raises(CellError) as caught:
                    await refused
                assert caught.value.name == "DEVICE_LOST"

        subject(scene)

    def test_a_silent_gripper_is_no_gripper_that_holds_nothing(self, subject: Bench[GripperRig]) -> None:
        subject.needs("part", "silence")

        async def scene(rig: GripperRig) -> None:
            assert await rig.device.grip(MOVES_S)
            await rig.inject("silence")
            await rig.clock.sleep(1.0)
            with pytest.raises(CellError) as caught:
                rig.device.holding(0.5)
            assert caught.value.name in ("STALE_DATA", "DEVICE_LOST")

        subject(scene, part=True)
