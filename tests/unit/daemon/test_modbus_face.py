"""What a PLC meets: commands, their sequences, and how they are acknowledged."""

import asyncio
import struct

import pytest

from daemon.modbus import Command, ModbusFace
from tests.kit.modbus_face_rig import HOST, Client, Plant, face_of, plant, subject, talk

__all__ = ["plant", "subject"]
NOT_IN_VERSION = 0x8000 + 6103
pytestmark = pytest.mark.wire


def test_a_command_is_carried_out_once_and_acknowledged_with_its_result(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        assert await plc.write(0, 1, 5, 7, 0, 0, 0) == "1000000006"
        assert await plc.acknowledged(5) == 1
        await plc.write(0, 1, 5, 7, 0, 0, 0)
        await plc.write(1, 5)
        await asyncio.sleep(0.05)

    talk(subject, script)
    (command,) = plant.commands
    assert (command.code, command.sequence, command.job) == (1, 5, 7)
    assert (command.channel, command.client) == ("modbus", HOST)
    assert plant.remembered == [5]


def test_a_start_that_sets_a_reserved_register_is_refused_with_a_code(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        await plc.write(3, 1)
        await plc.write(0, 1, 5, 7)
        assert await plc.acknowledged(5) == NOT_IN_VERSION
        await plc.write(3, 0)
        await plc.write(0, 1, 6, 7)
        assert await plc.acknowledged(6) == 1

    talk(subject, script)
    assert [c.sequence for c in plant.commands] == [6]


def test_a_start_brings_its_arguments(plant: Plant, subject: ModbusFace) -> None:
    async def script(plc: Client) -> None:
        await plc.write(0, 1, 5, 9, 0, 0, 4, 0, 2, 0x3E80, 0)
        assert await plc.acknowledged(5) == 1

    talk(subject, script)
    (command,) = plant.commands
    assert [command.argument_as_uint32(index) for index in range(3)] == [4, 2, 0x3E800000]


def test_the_reserved_control_bit_refuses_a_start_and_never_a_stop(plant: Plant, subject: ModbusFace) -> None:
    async def script(plc: Client) -> None:
        await plc.write(11, 2)
        await plc.write(0, 1, 5, 7)
        assert await plc.acknowledged(5) == NOT_IN_VERSION
        assert not (await plc.words(0, 1))[0] & 1 << 5
        await plc.write(3, 1)
        await plc.write(0, 3, 6)
        assert await plc.acknowledged(6) == 1

    talk(subject, script)
    assert [c.code for c in plant.commands] == [3]


def test_arguments_written_before_the_sequence_are_inert_until_it_comes(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        await plc.write(0, 8)
        await plc.write(4, 0, 42)
        await asyncio.sleep(0.05)
        assert plant.commands == []
        await plc.ask("0600010009")
        await plc.acknowledged(9)

    talk(subject, script)
    assert [(c.code, c.argument_uint32) for c in plant.commands] == [(8, 42)]


def test_a_sequence_acknowledged_before_a_restart_is_no_new_edge(plant: Plant) -> None:
    subject = face_of(plant, last_sequence=41)

    async def script(plc: Client) -> None:
        assert (await plc.words(1, 1))[0] == 41
        await plc.write(0, 1, 41, 1)
        await asyncio.sleep(0.05)
        assert plant.commands == []
        await plc.write(0, 1, 42, 1)
        await plc.acknowledged(42)

    talk(subject, script)
    assert [c.sequence for c in plant.commands] == [42]


def test_sequence_zero_is_none(plant: Plant, subject: ModbusFace) -> None:
    async def script(plc: Client) -> None:
        await plc.write(0, 1, 0, 1)
        await asyncio.sleep(0.05)

    talk(subject, script)
    assert plant.commands == []


def test_a_sequence_is_on_disk_before_its_command_is_carried_out(plant: Plant, subject: ModbusFace) -> None:
    seen: list[list[int]] = []
    handle = plant.handle

    async def handling(command: Command) -> int:
        seen.append(list(plant.remembered))
        return await handle(command)

    subject._on_command = handling

    async def script(plc: Client) -> None:
        await plc.write(0, 1, 5, 1)
        await plc.acknowledged(5)

    talk(subject, script)
    assert seen == [[5]]


@pytest.mark.parametrize("stop", [3, 4])
def test_a_stop_does_not_wait_behind_a_slow_start_and_the_start_does_not_come_out_after_it(
    plant: Plant, subject: ModbusFace, stop: int
) -> None:
    plant.delay_s = 0.3

    async def script(plc: Client) -> None:
        await plc.write(0, 1, 5, 1)
        await asyncio.sleep(0.05)
        await plc.write(0, stop, 6)
        assert await plc.acknowledged(6) == 1
        assert [c.code for c in plant.commands] == [1, stop]
        assert plant.finished == [stop]
        await asyncio.sleep(0.4)
        assert (await plc.words(1, 1))[0] == 6

    talk(subject, script)
    assert plant.finished == [stop]
    assert plant.remembered == [5, 6]


def test_a_stop_in_the_same_segment_withdraws_the_start_before_it(plant: Plant, subject: ModbusFace) -> None:
    plant.delay_s = 0.1

    async def script(plc: Client) -> None:
        plc.writer.write(
            plc.frame("10 0000 0003 06 0001 0005 0001") + plc.frame("10 0000 0003 06 0004 0006 0001")
        )
        await plc.reply()
        await plc.reply()
        await plc.acknowledged(6)
        await asyncio.sleep(0.15)

    talk(subject, script)
    assert plant.finished == [4]
    assert plant.remembered[-1] == 6


def test_a_refused_command_shows_the_error_and_a_defect_is_no_dead_link(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        plant.answer = 0x8000 | 6001
        await plc.write(0, 1, 5, 1)
        assert await plc.acknowledged(5) == 0x8000 | 6001
        plant.faulty = True
        await plc.write(0, 1, 6, 1)
        assert await plc.acknowledged(6) == 0x8000 | 9001

    talk(subject, script)


def test_an_accepted_command_reads_done_once_the_status_says_done(plant: Plant, subject: ModbusFace) -> None:
    async def script(plc: Client) -> None:
        await plc.write(0, 1, 5, 1)
        assert await plc.acknowledged(5) == 1
        plant.status |= 1 << 2
        await asyncio.sleep(0.02)
        assert (await plc.words(2, 1))[0] == 2

    talk(subject, script)


def test_32_bit_words_come_in_the_configured_order(plant: Plant) -> None:
    async def script(plc: Client) -> None:
        assert await plc.words(10, 2) == [2, 1]

    talk(face_of(plant, word_order="low-first"), script)


def test_any_unit_id_is_answered_with_itself_and_the_mirror_equals_the_status(
    subject: ModbusFace,
) -> None:
    async def script(plc: Client) -> None:
        for unit in (0, 1, 2, 77, 247, 255):
            plc.writer.write(plc.frame("0400000040", unit) + plc.frame("0303e80040", unit))
            first, second = await plc.reply(), await plc.reply()
            assert first[1] == second[1] == unit
            mask = struct.unpack(">64H", first[2][2:]), struct.unpack(">64H", second[2][2:])
            different = [i for i, (a, b) in enumerate(zip(*mask, strict=True)) if a != b]
            assert set(different) <= {0, 3}, "only a heartbeat may fall between the two"

    talk(subject, script)
