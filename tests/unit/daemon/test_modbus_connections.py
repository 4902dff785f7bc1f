"""What connections of a PLC and of strangers may send, and what they cost the others."""

import asyncio
import socket
import struct
from typing import Any

import pytest

from cell.errors import CellError
from daemon.modbus import ModbusFace
from daemon.modbus.pdu import respond
from tests.kit.modbus_face_rig import HOST, Client, Plant, connect, face_of, plant, run, subject, talk

__all__ = ["plant", "subject"]
pytestmark = pytest.mark.wire


@pytest.mark.parametrize("count", [2, 5, 20])
def test_pipelined_requests_in_one_segment_are_all_answered_in_order(subject: ModbusFace, count: int) -> None:
    """The case in which pymodbus 3.16 answers only the first."""

    async def script(plc: Client) -> None:
        plc.writer.write(b"".join(plc.frame("0400080001") for _ in range(count)))
        assert [await plc.reply() for _ in range(count)] == [
            (i, 1, bytes.fromhex("04020100")) for i in range(1, count + 1)
        ]

    talk(subject, script)


def test_a_request_in_single_bytes_is_answered(subject: ModbusFace) -> None:
    async def script(plc: Client) -> None:
        for byte in plc.frame("0400080001"):
            plc.writer.write(bytes([byte]))
            await plc.writer.drain()
            await asyncio.sleep(0.002)
        assert (await plc.reply())[2].hex() == "04020100"

    talk(subject, script)


@pytest.mark.parametrize(
    "garbage", [b"\xff" * 50, b"GET / HTTP/1.1\r\n\r\n", struct.pack(">HHHB", 1, 0, 300, 1), b"\0" * 16]
)
def test_a_stream_that_is_not_modbus_is_closed_and_the_next_connection_works(
    subject: ModbusFace, garbage: bytes
) -> None:
    async def script(plc: Client) -> None:
        plc.writer.write(garbage)
        assert await plc.ended()
        again = await connect(subject)
        assert await again.ask("0400080001") == "04020100"
        await again.close()

    talk(subject, script)


def test_garbage_of_a_stranger_leaves_a_polling_plc_and_answers_what_came_before_it(
    subject: ModbusFace,
) -> None:
    async def script(plc: Client) -> None:
        for noise in (b"\xff" * 50, bytes(range(256)) * 200, b"GET / HTTP/1.1\r\n\r\n"):
            vandal = await connect(subject, "127.0.0.44")
            vandal.writer.write(vandal.frame("0400080001") + noise)
            assert (await vandal.reply())[2].hex() == "04020100"
            assert await plc.ask("0400080001") == "04020100"
            assert await vandal.ended()
            await vandal.close()
        assert await plc.ask("0400080001") == "04020100"

    talk(subject, script)


def test_pipelined_requests_of_a_stranger_leave_a_polling_plc_its_turn(
    subject: ModbusFace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They come in one segment and are answered one a turn: the PLC waits for a few of them, not for all."""
    answered = 0

    def counted(*request: Any) -> bytes:
        nonlocal answered
        answered += 1
        return respond(*request)

    monkeypatch.setattr("daemon.modbus.server.respond", counted)

    async def script(plc: Client) -> None:
        stranger = await connect(subject, "127.0.0.44")
        stranger.writer.write(b"".join(stranger.frame("0400080001") for _ in range(3000)))
        await stranger.reply()
        assert await plc.ask("0400080001") == "04020100"
        assert answered < 200
        assert [(await stranger.reply())[0] for _ in range(2999)] == list(range(2, 3001))
        await stranger.close()

    talk(subject, script)


def test_an_unfinished_request_is_given_up(subject: ModbusFace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.modbus.server.FRAME_TIMEOUT_S", 0.1)

    async def script(plc: Client) -> None:
        plc.writer.write(plc.frame("0400080001")[:9])
        assert await plc.ended()

    talk(subject, script)


def test_a_silent_connection_is_closed_after_the_idle_time(plant: Plant) -> None:
    async def script(plc: Client) -> None:
        assert await plc.ended()

    talk(face_of(plant, idle_timeout_s=1.0), script)


def test_200_idle_connections_do_not_keep_a_polling_plc_out(plant: Plant) -> None:
    subject = face_of(plant, max_connections=8)

    async def script(plc: Client) -> None:
        assert await plc.ask("0400080001") == "04020100"
        idle = [await connect(subject, "127.0.0.44") for _ in range(200)]
        assert await plc.ask("0400080001") == "04020100"
        late = await connect(subject)
        assert await late.ask("0400080001") == "04020100"
        open_now = 0
        for client in idle:
            try:
                async with asyncio.timeout(0.01):
                    open_now += await client.reader.read(1) != b""
            except TimeoutError:
                open_now += 1
            except ConnectionError:
                continue
        assert open_now <= 8
        for client in (*idle, late):
            await client.close()

    talk(subject, script)


def test_a_client_that_reads_nothing_does_not_stop_the_others(
    subject: ModbusFace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.modbus.server.FRAME_TIMEOUT_S", 0.3)

    async def script(plc: Client) -> None:
        deaf = socket.create_connection(subject.address, source_address=(HOST, 0))
        deaf.setblocking(False)
        flood = plc.frame("0400000040") * 2000
        try:
            for _ in range(50):
                await asyncio.sleep(0)
                try:
                    deaf.send(flood)
                except (BlockingIOError, ConnectionError):
                    await asyncio.sleep(0.01)
                assert (await plc.words(8, 1)) == [0x0100]
        finally:
            deaf.close()

    talk(subject, script)


def test_a_defect_in_the_snapshot_is_exception_4_and_not_a_dead_connection(
    plant: Plant, subject: ModbusFace, caplog: pytest.LogCaptureFixture
) -> None:
    def broken() -> dict[str, Any]:
        raise RuntimeError("a defect")

    async def script(plc: Client) -> None:
        subject._snapshot = broken
        assert [await plc.ask("0400080001") for _ in range(3)] == ["8404"] * 3
        subject._snapshot = plant.snapshot
        assert await plc.ask("0400080001") == "04020100"

    talk(subject, script)
    assert len([r for r in caplog.records if "could not be answered" in r.message]) == 1


def test_an_address_that_is_taken_is_said_in_one_sentence(plant: Plant, subject: ModbusFace) -> None:
    async def scene() -> None:
        await subject.start()
        second = face_of(plant, bind="{}:{}".format(*subject.address))
        try:
            with pytest.raises(CellError, match=r"bind 127\.0\.0\.40:") as caught:
                await second.start()
            assert caught.value.name == "ADDRESS_NOT_SERVED"
        finally:
            await second.stop()
            await subject.stop()

    run(scene())


def test_a_disabled_face_opens_nothing(plant: Plant) -> None:
    async def scene() -> None:
        subject = face_of(plant, enabled=False)
        await subject.start()
        assert subject.address == (HOST, 0)
        await subject.stop()

    run(scene())


def test_stop_ends_commands_and_connections_and_writes_the_audit(plant: Plant, subject: ModbusFace) -> None:
    plant.delay_s = 30.0

    async def scene() -> None:
        await subject.start()
        plc = await connect(subject)
        await plc.write(0, 1, 5, 1)
        await subject.stop()
        assert await plc.ended()
        await plc.close()

    run(scene())
    assert [what for _, what, _, _ in plant.audit] == ["write 0..2", "command 1 sequence 5 job 1"]
    assert plant.finished == []
