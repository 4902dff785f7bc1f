"""The CAN trigger against a PLC written with python-can alone, on the bus of an encoder at 1 kHz."""

import asyncio
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from itertools import groupby
from pathlib import Path
from typing import Any

import can
import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError, catalogue
from daemon.can.face import CanFace
from daemon.config.faces import CanSection
from daemon.demo import can_node
from daemon.modbus.command import Command
from drivers.can_encoder import CanopenEncoder
from fakes.can.bus import Frame
from tests.kit.can_rig import CanRig, can_rig

pytestmark = pytest.mark.wire
HOST = "127.0.51.9"
START, FINISH, ABORT, ACCEPT = 1, 2, 3, 8
COMMAND_ID, ACKNOWLEDGE_ID, STATUS_ID, HEARTBEAT_ID, PLC_HEARTBEAT_ID = 0x300, 0x301, 0x302, 0x77E, 0x710
TOGGLE = 1 << 15
OTHER = {"slcan": "socketcand", "socketcand": "slcan"}


class Plc:
    """A PLC's program: python-can, and nothing of ours."""

    def __init__(self, rig: CanRig, interface: str) -> None:
        if interface == "socketcand":
            host, port = rig.wires.gateway.address  # type: ignore[union-attr]
            self._bus: can.BusABC = can.Bus(interface="socketcand", host=host, port=port, channel="can0")
        else:
            path = str(rig.wires.adapter.path)  # type: ignore[union-attr]
            self._bus = can.Bus(interface="slcan", channel=path, bitrate=250_000, sleep_after_open=0.0)

    def close(self) -> None:
        self._bus.shutdown()

    def send(self, identifier: int, data: bytes, **how: Any) -> None:
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        for key, value in how.items():
            setattr(message, key, value)
        self._bus.send(message)

    def wait(self, identifier: int, seconds: float = 5.0) -> bytes | None:
        """The next frame with this identifier."""
        give_up, message = time.monotonic() + seconds, None
        while (left := give_up - time.monotonic()) > 0.0:
            with suppress(ValueError):  # its own reader stumbles over a line that its timeout cut in two
                message = self._bus.recv(left)
            if message is not None and message.arbitration_id == identifier:
                return bytes(message.data)
        return None

    def command(self, code: int, sequence: int, job: int = 0, argument: int = 0) -> tuple[int, ...] | None:
        """Give a command; sequence, result, status and error of its acknowledge."""
        self.send(COMMAND_ID, struct.pack("<BBHI", code, job, sequence, argument))
        return self.acknowledge()

    def ask_until_told(self, code: int, sequence: int, job: int = 0) -> tuple[int, ...]:
        """As :meth:`command`; a client whose own reader lost the answer asks again, as the manual says."""
        return self.send_until_told(struct.pack("<BBHI", code, job, sequence, 0))

    def send_until_told(self, data: bytes, **how: Any) -> tuple[int, ...]:
        """The answer to ``data`` as a command, which is sent again as long as none was read."""
        for _ in range(5):
            self.send(COMMAND_ID, data, **how)
            if (told := self.acknowledge(2.0)) is not None:
                return told
        return ()

    def acknowledge(self, seconds: float = 5.0) -> tuple[int, ...] | None:
        data = self.wait(ACKNOWLEDGE_ID, seconds)
        if data is None:
            return None
        sequence, result, status, failure = struct.unpack("<HHHH", data)
        return sequence, result, status & ~TOGGLE, failure


class Engine:
    """What is behind the face: it notes commands, and knows job 1 alone."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.audited: list[tuple[Any, ...]] = []
        self.remembered: list[int] = []
        self.plc: list[bool] = []

    async def handle(self, command: Command) -> int:
        self.commands.append(command)
        return refusal("UNKNOWN_JOB") if command.code == START and command.job != 1 else 1

    def snapshot(self) -> dict[str, Any]:
        return {"status": 1, "error_code": 4711, "packml_state": 4, "active_job": 0, "prompt_id": 70_001}


def refusal(name: str) -> int:
    return 0x8000 | catalogue()[name].code


async def seen(true: Callable[[], bool], within_s: float) -> bool:
    for _ in range(round(100.0 * within_s)):
        if true():
            return True
        await asyncio.sleep(0.01)
    return False


async def until(true: Callable[[], bool]) -> None:
    assert await seen(true, 10.0), "not within 10 s"


Script = Callable[[Plc, Engine, CanRig, CanFace], Awaitable[None]]


@asynccontextmanager
async def on_the_bus(
    rig: CanRig, interface: str, engine: Engine, last_sequence: int = 0, **keys: Any
) -> AsyncIterator[CanFace]:
    """A face on the daemon's end of the bus, connected."""
    section = CanSection.model_validate({"enabled": True, "bus": rig.wires.buses[interface], **keys})
    face = CanFace(
        section,
        MonotonicClock(),
        engine.handle,
        engine.snapshot,
        audit=lambda *line: engine.audited.append(line),
        on_plc=engine.plc.append,
        last_sequence=last_sequence,
        remember=engine.remembered.append,
    )
    await face.start()
    try:
        await until(lambda: face.connected)
        yield face
    finally:
        await face.stop()


def play(interface: str, script: Script, **keys: Any) -> Engine:
    """Run ``script`` with the daemon on ``interface`` and the PLC on the other one of the same bus."""
    engine = Engine()

    async def whole() -> None:
        async with can_rig(HOST) as rig:
            plc = await asyncio.to_thread(Plc, rig, OTHER[interface])
            try:
                async with on_the_bus(rig, interface, engine, **keys) as face:
                    await script(plc, engine, rig, face)
            finally:
                await asyncio.to_thread(plc.close)

    asyncio.run(whole())
    return engine


@pytest.fixture(params=["slcan", "socketcand"])
def interface(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_a_command_is_carried_out_once_and_its_acknowledge_is_repeated(interface: str) -> None:
    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        whole = struct.pack("<BBHI", START, 1, 1, 70_004)
        assert await asyncio.to_thread(plc.send_until_told, whole) == (1, 1, 1, 4711)
        assert [engine.commands[0].argument_as_uint32(index) for index in range(3)] == [70_004, 0, 0]
        rig.bus.faults.lose[ACKNOWLEDGE_ID] = 1
        lost = struct.pack("<BBHI", FINISH, 0, 2, 0)
        await asyncio.to_thread(plc.send, COMMAND_ID, lost)
        assert await asyncio.to_thread(plc.acknowledge, 0.5) is None
        assert await asyncio.to_thread(plc.ask_until_told, FINISH, 2) == (2, 1, 1, 4711)
        assert [(c.code, c.sequence, c.job, c.channel) for c in engine.commands] == [
            (START, 1, 1, "can"),
            (FINISH, 2, 0, "can"),
        ]

    engine = play(interface, script)
    assert engine.remembered == [1, 2]
    assert [what for _, what, accepted, _ in engine.audited if accepted] == [
        "command 1 sequence 1 job 1",
        "command 2 sequence 2 job 0",
    ]


def test_the_demos_plc_starts_a_job_and_names_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        host, port = rig.wires.gateway.address  # type: ignore[union-attr]
        monkeypatch.setattr(can_node, "GATEWAY_PORT", port)
        node = can_node.PlcOnCan(host, 502)
        monkeypatch.setattr(node, "poll", lambda: None)
        rig.bus.faults.lose[COMMAND_ID] = 1
        await asyncio.to_thread(node.start_over_can, 1)
        with pytest.raises(CellError, match="over CAN") as told:
            await asyncio.to_thread(node.start_over_can, 99)
        assert told.value.name == "UNKNOWN_JOB"
        assert [(c.code, c.sequence, c.job) for c in engine.commands] == [(START, 1, 1), (START, 2, 99)]

    play("slcan", script)


def test_the_sequence_of_before_a_restart_does_nothing(interface: str) -> None:
    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        assert await asyncio.to_thread(plc.ask_until_told, START, 7, 1) == (7, 0, 1, 4711)
        assert engine.commands == []

    play(interface, script, last_sequence=7)


def test_what_is_no_command_is_answered_and_audited(interface: str) -> None:
    invalid = refusal("ARGUMENT_INVALID")

    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        whole = struct.pack("<BBHI", START, 1, 3, 0)
        for data, how, sequence in (
            (whole[:5], {}, 3),
            (whole[:2], {}, 0),
            (whole, {"is_extended_id": True}, 3),
            (struct.pack("<BBHI", START, 1, 0, 0), {}, 0),
        ):
            told = await asyncio.to_thread(plc.send_until_told, data, **how)
            assert told == (sequence, invalid, 1, 4711)
        assert await asyncio.to_thread(plc.ask_until_told, 0, 4) == (4, invalid, 1, 4711)
        told = await asyncio.to_thread(plc.ask_until_told, START, 5, 99)
        assert told == (5, refusal("UNKNOWN_JOB"), 1, 4711)
        plc.send(COMMAND_ID + 0x40, whole)  # another identifier is somebody else's
        assert await asyncio.to_thread(plc.acknowledge, 0.3) is None

    engine = play(interface, script)
    refused = [detail.partition(";")[0] for _, what, accepted, detail in engine.audited if not accepted]
    why = [text for text, _ in groupby(refused)]  # one that was sent again is audited again
    assert why[:4] == [
        "5 bytes instead of 8",
        "2 bytes instead of 8",
        "an identifier of 29 bits",
        "sequence 0",
    ]
    assert len(why) == 6


def test_heartbeat_and_status_tell_a_plc_what_there_is(interface: str) -> None:
    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        assert await asyncio.to_thread(plc.wait, HEARTBEAT_ID) in (b"\x00", b"\x05")
        assert await asyncio.to_thread(plc.wait, HEARTBEAT_ID) == b"\x05"
        data = await asyncio.to_thread(plc.wait, STATUS_ID)
        assert data is not None
        bits, state, job, prompt = struct.unpack("<HBBI", data)
        assert (bits & 0x7FFF, state, job, prompt) == (1, 4, 0, 70_001)

    play(interface, script)


def test_a_plc_that_falls_silent_holds_the_job_and_only_stops_are_taken(interface: str) -> None:
    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        for _ in range(10):  # an adapter that was just opened may lose a frame
            await asyncio.to_thread(plc.send, PLC_HEARTBEAT_ID, b"\x05")
            if await seen(lambda: engine.plc == [False], 1.0):
                break
        assert engine.plc == [False]
        silent = refusal("PLC_SILENT")
        assert (await asyncio.to_thread(plc.ask_until_told, START, 1, 1))[:2] == (1, silent)
        assert (await asyncio.to_thread(plc.ask_until_told, ABORT, 2))[:2] == (2, 1)
        await asyncio.to_thread(plc.send, PLC_HEARTBEAT_ID, b"\x05")
        await until(lambda: engine.plc == [False, True])

    play(interface, script, plc_node=0x10, heartbeat_timeout_s=0.3)


def test_an_encoder_at_1_khz_on_the_same_bus_loses_no_frame(interface: str) -> None:
    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        device: CanopenEncoder = rig.driver(interface, period_s=0.001, lost_after_s=5.0)
        position = rig.node.position_id
        await device.open()
        try:
            await device.wait_fresh(5.0)
            sent: list[bytes] = []
            answers: list[int] = []  # as they were on the bus
            taken: list[bytes] = []

            def look(frame: Frame, t: float) -> None:
                if frame.id == position:
                    sent.append(frame.data)
                elif frame.id == ACKNOWLEDGE_ID:
                    answers.append(int.from_bytes(frame.data[:2], "little"))

            rig.bus.join(look)
            began = time.monotonic()
            device.counts.subscribe(lambda sample: taken.append(sample.value.raw.to_bytes(4, "little")))
            for sequence in range(1, 31):
                assert (await asyncio.to_thread(plc.ask_until_told, FINISH, sequence))[:2] == (sequence, 1)
                await asyncio.sleep(0.05)
            rig.node.silent = True
            await asyncio.sleep(0.2)
            assert len(taken) > 1000
            assert taken[-len(sent) :] == sent[-len(taken) :], "all but those that were on their way at first"
            assert face.connected
            assert list(dict.fromkeys(answers)) == list(range(1, 31)), "in their order, none left out"
            rate = len(sent) / (time.monotonic() - began)
            print(f"{interface}: {len(sent)} encoder frames, {rate:.0f} a second, 30 commands, none lost")
        finally:
            await device.close()
        assert (await asyncio.to_thread(plc.ask_until_told, FINISH, 31))[:2] == (31, 1), "the bus stays open"

    engine = play(interface, script)
    assert len(engine.commands) == 31


def test_an_adapter_that_was_pulled_out_is_opened_again_when_it_is_back() -> None:
    async def script(plc: Plc, engine: Engine, rig: CanRig, face: CanFace) -> None:
        adapter = rig.wires.adapter
        assert adapter is not None
        adapter.pull_out()
        await until(lambda: not face.connected)
        adapter.plug_in()
        await until(lambda: face.connected)
        assert await asyncio.to_thread(plc.ask_until_told, FINISH, 1) == (1, 1, 1, 4711)

    play("slcan", script)


@pytest.mark.skipif(not Path("/sys/class/net/vcan0").exists(), reason="the kernel has no interface vcan0")
def test_a_command_over_the_kernels_own_can() -> None:
    engine = Engine()

    async def whole() -> None:
        bus = can.Bus(interface="socketcan", channel="vcan0")
        plc = Plc.__new__(Plc)
        plc._bus = bus
        section = CanSection.model_validate({"enabled": True, "bus": "socketcan:vcan0"})
        face = CanFace(section, MonotonicClock(), engine.handle, engine.snapshot)
        await face.start()
        try:
            await until(lambda: face.connected)
            assert await asyncio.to_thread(plc.ask_until_told, START, 1, 1) == (1, 1, 1, 4711)
        finally:
            await face.stop()
            bus.shutdown()

    asyncio.run(whole())
