"""What a PLC meets: permissions, sequences, heartbeats and the limits of the server, on real sockets."""

import asyncio
import socket
import struct
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cell.clock import MonotonicClock
from cell.errors import CellError
from daemon.config import ModbusSection
from daemon.modbus import Command, ModbusFace
from daemon.modbus.pdu import respond

pytestmark = pytest.mark.wire
HOST = "127.0.0.40"


@dataclass
class Plant:
    """The daemon behind the face: records commands, answers with ``answer``."""

    answer: int = 1
    status: int = 1
    delay_s: float = 0.0
    commands: list[Command] = field(default_factory=list)
    audit: list[tuple[str, str, bool, str]] = field(default_factory=list)
    remembered: list[int] = field(default_factory=list)
    plc: list[bool] = field(default_factory=list)
    finished: list[int] = field(default_factory=list)
    faulty: bool = False

    async def handle(self, command: Command) -> int:
        self.commands.append(command)
        if self.delay_s and command.code not in (3, 4):
            await asyncio.sleep(self.delay_s)
        if self.faulty:
            raise RuntimeError("a defect")
        self.finished.append(command.code)
        return self.answer

    def snapshot(self) -> dict[str, Any]:
        return {"status": self.status, "run_id": 0x00010002, "belt_speed_m_s": 0.25, "packml_state": 4}


def face_of(plant: Plant, clock: Any = None, last_sequence: int = 0, **keys: Any) -> ModbusFace:
    section = {"bind": f"{HOST}:0", "allow_write": True, "allow_clients": ["127.0.0.0/8"], **keys}
    return ModbusFace(
        ModbusSection.model_validate(section),
        clock or MonotonicClock(),
        plant.handle,
        plant.snapshot,
        audit=lambda *line: plant.audit.append(line),
        on_plc=plant.plc.append,
        last_sequence=last_sequence,
        remember=plant.remembered.append,
    )


class Client:
    """A raw Modbus client: frames by hand, so that the server is not judged by a library's habits."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.transaction = 0

    def frame(self, pdu: str, unit: int = 1) -> bytes:
        self.transaction += 1
        body = bytes.fromhex(pdu)
        return struct.pack(">HHHB", self.transaction, 0, len(body) + 1, unit) + body

    async def reply(self) -> tuple[int, int, bytes]:
        async with asyncio.timeout(5.0):
            transaction, _, length, unit = struct.unpack(">HHHB", await self.reader.readexactly(7))
            return transaction, unit, await self.reader.readexactly(length - 1)

    async def ask(self, pdu: str, unit: int = 1) -> str:
        self.writer.write(self.frame(pdu, unit))
        return (await self.reply())[2].hex()

    async def words(self, address: int, count: int) -> list[int]:
        reply = bytes.fromhex(await self.ask(f"04{address:04x}{count:04x}"))
        assert reply[0] == 4, reply.hex()
        return list(struct.unpack(f">{count}H", reply[2:]))

    async def write(self, address: int, *values: int) -> str:
        data = "".join(f"{value:04x}" for value in values)
        return await self.ask(f"10{address:04x}{len(values):04x}{2 * len(values):02x}{data}")

    async def acknowledged(self, sequence: int) -> int:
        """The result code once ``sequence`` is acknowledged."""
        async with asyncio.timeout(5.0):
            while True:
                words = await self.words(1, 2)
                if words[0] == sequence:
                    return words[1]
                await asyncio.sleep(0.005)

    async def ended(self) -> bool:
        async with asyncio.timeout(5.0):
            try:
                return await self.reader.read(1) == b""
            except ConnectionError:
                return True

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            return


async def connect(face: ModbusFace, source: str = HOST) -> Client:
    return Client(*await asyncio.open_connection(*face.address, local_addr=(source, 0)))


def talk(subject: ModbusFace, script: Callable[[Client], Awaitable[None]], source: str = HOST) -> None:
    """Start the face, run ``script`` with one client, stop the face."""

    async def scene() -> None:
        await subject.start()
        try:
            client = await connect(subject, source)
            try:
                await script(client)
            finally:
                await client.close()
        finally:
            await subject.stop()

    run(scene())


def run(scene: Coroutine[Any, Any, None]) -> None:
    asyncio.run(scene)


@pytest.fixture
def plant() -> Plant:
    return Plant()


@pytest.fixture
def subject(plant: Plant) -> ModbusFace:
    return face_of(plant)


def test_a_command_is_carried_out_once_and_acknowledged_with_its_result(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        high, low = struct.unpack(">HH", struct.pack(">f", 0.75))
        assert await plc.write(0, 1, 5, 7, 3, high, low) == "1000000006"
        assert await plc.acknowledged(5) == 1
        await plc.write(0, 1, 5, 7, 3, high, low)
        await plc.write(1, 5)
        await asyncio.sleep(0.05)

    talk(subject, script)
    (command,) = plant.commands
    assert (command.code, command.sequence, command.job, command.flags) == (1, 5, 7, 3)
    assert command.argument_float(0) == 0.75
    assert (command.channel, command.client) == ("modbus", HOST)
    assert plant.remembered == [5]


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


@pytest.mark.parametrize(
    ("pdu", "reply"),
    [
        ("0600200001", "8602"),  # behind the command block
        ("06001f0001", "06001f0001"),  # its last register
        ("0603e80001", "8602"),  # the mirror is for reading
        ("10001f0002040001 0001", "9002"),
        ("060000000b", "8603"),  # there is no command 11
        ("06000b0010", "8603"),  # there is no control bit 4
        ("0300000021", "8302"),
        ("0300200001", "8302"),
        ("0303e80041", "8302"),
        ("0400400001", "8402"),
        ("020000 0021", "8202"),
        ("0500000000", "8502"),
    ],
)
def test_what_is_not_there_is_exception_2_and_a_bad_value_exception_3(
    subject: ModbusFace, pdu: str, reply: str
) -> None:
    async def script(plc: Client) -> None:
        assert await plc.ask(pdu) == reply

    talk(subject, script)


def test_a_write_of_several_registers_is_taken_whole_or_not_at_all(plant: Plant, subject: ModbusFace) -> None:
    async def script(plc: Client) -> None:
        assert await plc.write(0, 1, 5, 1, 0, 0, 0, 0, 0, 0, 0, 0, 999) == "9003"
        assert await plc.ask("0300000003") == "0306" + "0000" * 3

    talk(subject, script)
    assert plant.commands == []


@pytest.mark.parametrize(
    ("keys", "source", "why"),
    [
        ({"allow_write": False}, HOST, "allow_write is false"),
        ({"allow_clients": []}, HOST, "not in [modbus] allow_clients"),
        ({"allow_clients": ["127.0.0.41"]}, HOST, "not in [modbus] allow_clients"),
        ({"allow_clients": ["10.0.0.0/8"]}, "127.0.0.42", "not in [modbus] allow_clients"),
    ],
)
def test_who_may_not_write_reads_all_the_same_and_the_attempt_is_audited(
    plant: Plant, keys: dict[str, Any], source: str, why: str
) -> None:
    async def script(plc: Client) -> None:
        assert await plc.write(0, 1, 5, 1) == "9002"
        assert (await plc.words(0, 1))[0] & 1

    talk(face_of(plant, **keys), script, source)
    assert plant.commands == []
    ((who, what, accepted, detail),) = plant.audit
    assert (who, what, accepted) == (source, "write 0..2", False)
    assert why in detail


def test_a_listed_client_may_write(plant: Plant) -> None:
    async def script(plc: Client) -> None:
        await plc.write(0, 1, 5, 1)
        await plc.acknowledged(5)

    talk(face_of(plant, allow_clients=["10.0.0.0/8", "127.0.0.43"]), script, "127.0.0.43")
    assert len(plant.commands) == 1


def test_writes_and_what_became_of_them_are_audited_but_not_each_heartbeat(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        for beat in range(1, 20):
            await plc.write(10, beat)
        await plc.write(0, 1, 5, 1)
        await plc.acknowledged(5)
        await plc.write(20, 1)
        await plc.write(40, 1)

    talk(subject, script)
    assert [(what, accepted) for _, what, accepted, _ in plant.audit] == [
        ("write 0..2", True),
        ("command 1 sequence 5 job 1", True),
        ("write 20", True),
        ("write 40", False),
    ]


def test_a_flood_of_refused_writes_is_counted_not_listed_without_end(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.auditor.MAX_WAITING", 5)
    subject = face_of(plant, allow_write=False)

    async def script(plc: Client) -> None:
        plc.writer.write(b"".join(plc.frame("0600000001") for _ in range(40)))
        for _ in range(40):
            await plc.reply()

    talk(subject, script)
    listed = [line for line in plant.audit if line[1] == "write 0"]
    counted = sum(int(line[1].split()[0]) for line in plant.audit if "further writes" in line[1])
    assert len(listed) + counted == 40
    assert counted > 0


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
        assert (await plc.words(0, 1))[0] & 1 << 5, "automatic follows control bit 1"

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


@given(st.binary(min_size=1, max_size=253))
@example(bytes.fromhex("17000000010000000102000b"))
def test_no_request_of_a_stranger_is_a_defect_or_gets_more_than_a_reading(request_bytes: bytes) -> None:
    plant = Plant()
    subject = face_of(plant, allow_clients=["10.0.0.1"])
    reply = respond(subject, request_bytes, "127.0.0.99")
    assert reply[0] & 0x7F == request_bytes[0] & 0x7F
    assert plant.commands == []
    assert subject.read_holding(0, 32) == [0] * 32
