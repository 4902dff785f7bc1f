"""Signs of life between a PLC and us, and the bits that act by level or by edge."""

import asyncio

import pytest

from daemon.modbus import ModbusFace
from tests.kit.modbus_face_rig import Client, Plant, face_of, plant, subject, talk

__all__ = ["plant", "subject"]
pytestmark = pytest.mark.wire


class TurnedClock:
    """A clock that the test turns."""

    def __init__(self) -> None:
        self.t = 100.0

    def now(self) -> float:
        return self.t

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(0)


def test_our_heartbeat_grows_by_one_each_100_ms_and_the_toggle_follows_it(plant: Plant) -> None:
    clock = TurnedClock()

    async def script(plc: Client) -> None:
        for step in range(1, 30):
            clock.t = 100.0 + 0.1 * step
            words = await plc.words(0, 4)
            assert words[3] == step
            assert words[0] >> 15 == step & 1
        clock.t = 100.0 + 0.1 * 0x10003
        assert (await plc.words(3, 1))[0] == 3

    talk(face_of(plant, clock), script)


def test_a_silent_plc_is_noticed_once_seen_and_only_stops_are_taken_from_it(plant: Plant) -> None:
    clock = TurnedClock()

    async def settle() -> None:
        for _ in range(10):
            await asyncio.sleep(0)

    async def script(plc: Client) -> None:
        clock.t += 60.0
        await settle()
        assert plant.plc == [], "a PLC that never beat is not missed"
        await plc.write(10, 1)
        assert (await plc.words(0, 1))[0] & 1 << 12
        clock.t += 0.9
        await plc.write(10, 1)  # the same value is no beat
        await settle()
        assert plant.plc == []
        clock.t += 0.2
        await settle()
        assert plant.plc == [False]
        assert not (await plc.words(0, 1))[0] & 1 << 12
        await plc.write(0, 1, 5, 1)
        assert await plc.acknowledged(5) == 0x8000 | 6101
        await plc.write(0, 4, 6, 1)
        assert await plc.acknowledged(6) == 1
        await plc.write(10, 2)
        assert plant.plc == [False, True]
        await plc.write(0, 1, 7, 1)
        assert await plc.acknowledged(7) == 1

    talk(face_of(plant, clock), script)
    assert [c.code for c in plant.commands] == [4, 1]
    assert [what for _, what, _, _ in plant.audit if "heartbeat" in what] == [
        "heartbeat lost", "heartbeat back",
    ]  # fmt: skip


def test_the_reset_bit_acts_on_its_rising_edge_and_not_on_the_level_found_first(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        await plc.write(11, 8)
        await plc.write(11, 8)
        await asyncio.sleep(0.02)
        assert plant.commands == []
        await plc.write(11, 2)
        await plc.write(11, 10)
        await asyncio.sleep(0.02)

    talk(subject, script)
    assert [c.code for c in plant.commands] == [7]


def test_starting_can_be_tied_to_the_enable_bit(plant: Plant) -> None:
    async def script(plc: Client) -> None:
        await plc.write(0, 1, 5, 1)
        assert await plc.acknowledged(5) == 0x8000 | 6102
        await plc.write(11, 1)
        await plc.write(0, 1, 6, 1)
        assert await plc.acknowledged(6) == 1

    talk(face_of(plant, require_enable=True), script)
