"""The CAN encoder's driver on a real serial line and real sockets: what has gone wrong with such links."""

import asyncio
import socket
import threading
import time
from collections.abc import Awaitable, Callable, Sequence
from itertools import pairwise
from pathlib import Path

import can
import numpy as np
import psutil
import pytest

from cell.clock import MonotonicClock
from cell.devices import Encoder
from cell.errors import CellError
from cell.samples import Quality
from cell.wire_recording.reader import read_recording
from cell.wire_recording.tap import recorded_by
from cell.wire_recording.writer import WireRecorder
from drivers.can_bus.address import parse_bus
from drivers.can_bus.shared import Ids, bus_at
from drivers.can_encoder import CanopenEncoder, RawCanEncoder, RawCanEncoderConfig
from fakes.can.bus import Frame
from fakes.faults.vocabulary import Fault
from procedures.belt.count_origin import CountOrigin
from tests.kit.can_rig import NODE, CanRig, TestShaft, can_rig

pytestmark = pytest.mark.wire
HOST = "127.0.51.4"
Script = Callable[[CanRig, CanopenEncoder], Awaitable[None]]


@pytest.fixture(params=["slcan", "socketcand"])
def interface(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def play(interface: str, script: Script, shaft: TestShaft | None = None, **keys: object) -> None:
    """Run ``script`` with an open driver."""

    async def whole() -> None:
        async with can_rig(HOST, shaft) as rig:
            device = rig.driver(interface, **keys)
            try:
                await device.open()
                await device.wait_fresh(5.0)
                await script(rig, device)
            finally:
                await device.close()

    asyncio.run(whole())


async def loss_of(device: Encoder) -> CellError:
    async with asyncio.timeout(10.0):
        found = await device.wait_lost()
    assert isinstance(found, CellError)
    return found


def test_frames_a_millisecond_apart_all_arrive(interface: str) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        sent, taken = [], []
        rig.bus.join(lambda frame, t: sent.append(frame.data) if frame.id == rig.node.position_id else None)
        device.counts.subscribe(lambda sample: taken.append(sample.value.raw.to_bytes(4, "little")))
        await asyncio.sleep(2.0)
        rig.node.silent = True
        await asyncio.sleep(0.1)
        assert len(taken) > 1500
        assert taken[-len(sent) :] == sent[-len(taken) :], "all but those that were on their way at first"
        assert device.health()["malformed"] == 0

    play(interface, script, period_s=0.001, lost_after_s=1.0)


def test_a_range_that_is_no_power_of_two_is_unwrapped(interface: str) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        await asyncio.sleep(0.5)
        samples = device.counts.between(0.0, 1e12)
        assert device.modulus == 1003
        assert samples[-1].value.count > 2000
        steps = [b.value.count - a.value.count for a, b in pairwise(samples)]
        # 50 counts a period; several when the busy sender of this process left a frame out.
        assert all(step > 0 and abs(step - 50 * round(step / 50)) <= 1 for step in steps)

    play(interface, script, TestShaft(speed=10_000.0, modulus=1003))


def test_a_position_that_somebody_sets_is_a_jump_unless_it_is_zero_and_a_wrap_is_none(interface: str) -> None:
    shaft = TestShaft(speed=10_000.0)
    shaft.preset(time.monotonic(), shaft.modulus - 10_000)

    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        told: list[str] = []
        origin = CountOrigin(device, {"m_per_count": 1e-4}, lambda event, **_: told.append(event))
        device.counts.subscribe(lambda sample: told.append("moved") if origin.moved(sample) else None)

        async def set_to(position: int) -> None:
            shaft.preset(time.monotonic(), position)
            await asyncio.sleep(0.1)
            await device.wait_fresh(5.0)

        await asyncio.sleep(1.2)
        assert told == [], "it has wrapped"
        await set_to(32_000)
        assert told == ["encoder jump", "moved"]
        await set_to(0)
        assert told[2:] == ["counts begin anew", "moved"]
        assert device.counts.epoch == 1

    play(interface, script, shaft)


def test_lines_that_are_no_frames_cost_nothing_but_themselves(interface: str) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        for _ in range(5):
            rig.faults.inject(Fault.JUNK, {})
            await asyncio.sleep(0.02)
        await device.wait_fresh(5.0)
        assert device.health()["malformed"] >= 5
        steps = [b.value.count - a.value.count for a, b in pairwise(device.counts.between(0.0, 1e12))]
        assert all(0 < step < 100 for step in steps), "no position was made of half a line"

    play(interface, script)


def test_frames_that_arrive_in_pieces_are_put_together(interface: str) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        rig.faults.inject(Fault.SPLIT, {})
        before = device.counts.received
        more = asyncio.Event()
        device.counts.subscribe(lambda sample: more.set() if device.counts.received > before + 30 else None)
        async with asyncio.timeout(5.0):
            await more.wait()
        assert device.health()["malformed"] == 0

    play(interface, script)


def test_frames_that_come_twice_are_taken_once_in_time(interface: str) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        rig.faults.inject(Fault.DUPLICATE, {})
        await asyncio.sleep(0.2)
        samples = device.counts.between(0.0, 1e12)
        assert all(a.t <= b.t and a.value.count <= b.value.count for a, b in pairwise(samples))

    play(interface, script)


@pytest.mark.parametrize("fault", [Fault.DROP, Fault.REFUSE])
def test_a_link_that_is_gone_costs_no_processor_time_and_leaves_no_thread(
    interface: str, fault: Fault
) -> None:
    """python-can alone spins here: readers of a pulled adapter, and of a gateway that closed."""

    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        rig.faults.inject(fault, {})
        assert (await loss_of(device)).name == "DEVICE_LOST"
        rig.node.power_off()
        rig.faults.close()
        used = psutil.Process().cpu_times()
        await asyncio.sleep(0.5)
        now = psutil.Process().cpu_times()
        assert now.user + now.system - used.user - used.system < 0.2
        await device.close()

    before = threading.active_count()
    play(interface, script)
    assert threading.active_count() <= before


def test_a_silent_link_is_found_out_by_the_drivers_own_watch(interface: str) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        rig.faults.inject(Fault.HALF_OPEN, {})
        begun = time.monotonic()
        failure = await loss_of(device)
        assert failure.name == "DEVICE_LOST"
        assert "no position for" in failure.detail
        assert 0.1 < time.monotonic() - begun < 1.5

    play(interface, script, lost_after_s=0.15)


def test_an_emergency_is_told_in_words_until_it_is_taken_back(
    interface: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        with caplog.at_level("INFO", "cellward.devices"):
            for _ in range(3):
                rig.faults.inject(Fault.ALARM, {"code": 0x4210, "register": 9})
            await device.wait_fresh(5.0)
            assert device.health()["emergency"] == "temperature of the device (4210h; generic, temperature)"
            assert device.counts.latest(1.0).quality is Quality.DEGRADED
            rig.faults.clear()
            await device.wait_fresh(5.0)
            assert device.health()["emergency"] == ""
            assert device.counts.latest(1.0).quality is Quality.GOOD
        told = [r.getMessage() for r in caplog.records if r.name == "cellward.devices"]
        assert told == [
            f"belt: node {NODE} reports temperature of the device (4210h; generic, temperature)",
            f"belt: node {NODE} is without error again",
        ]

    play(interface, script)


def test_emergencies_that_alternate_fill_no_log(interface: str, caplog: pytest.LogCaptureFixture) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        with caplog.at_level("INFO", "cellward.devices"):
            for code in (0x4210, 0x8120) * 20:
                rig.faults.inject(Fault.ALARM, {"code": code, "register": 9})
            await device.wait_fresh(5.0)
            assert device.health()["emergency"].startswith("CAN error passive")
        told = [r.getMessage() for r in caplog.records if r.name == "cellward.devices"]
        assert [text.split("(")[0] for text in told] == [
            f"belt: node {NODE} reports temperature of the device ",
            f"belt: node {NODE} reports CAN error passive ",
            f"belt: node {NODE}'s emergencies change often: each is told once in 60 s",
        ]

    play(interface, script)


def test_a_node_whose_heart_stops_is_lost_though_positions_come(interface: str) -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        other_master = rig.bus.join(lambda frame, t: None)
        no_heartbeat = bytes.fromhex("2b17100000000000")
        other_master.send(Frame(0x600 + NODE, no_heartbeat), time.monotonic())
        assert "sent no heartbeat" in (await loss_of(device)).detail

    play(interface, script, heartbeat_s=0.05, lost_after_s=0.25)


@pytest.mark.parametrize("delay_s", [0.0, 0.1], ids=["at once", "late"])
def test_a_bus_that_goes_off_shortly_before_a_heartbeat_is_told_by_name(delay_s: float) -> None:
    """Positions and heartbeat end together, the latest heartbeat earlier; the adapter may answer late."""

    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        beat = asyncio.Event()
        rig.bus.join(lambda frame, t: beat.set() if frame.id == 0x700 + NODE else None)
        await beat.wait()
        await asyncio.sleep(0.15)
        rig.faults.inject(Fault.BUS_OFF, {})
        rig.faults.inject(Fault.DELAY, {"s": delay_s})
        assert (await loss_of(device)).name == "CAN_BUS_OFF"

    play("slcan", script, heartbeat_s=0.2, lost_after_s=0.6)


def test_a_gateways_stamps_are_exact_and_survive_a_jump_of_its_clock() -> None:
    async def script(rig: CanRig, device: CanopenEncoder) -> None:
        await asyncio.sleep(0.5)
        ages: list[float] = []
        device.counts.subscribe(lambda sample: ages.append(time.monotonic() - sample.t))
        rig.faults.inject(Fault.CLOCK_JUMP, {"s": -3600.0})
        await asyncio.sleep(0.3)
        samples = device.counts.between(0.0, 1e12)
        assert device.health()["stamps_refused"] == 1
        assert device.counts.epoch == 1
        off = [s.value.count / 1000.0 - s.t for s in samples]
        assert max(off) - min(off) < 0.1
        assert np.median(np.abs(ages)) < 0.1

    play("socketcand", script)


def test_an_adapter_set_to_another_bit_rate_is_told_as_a_bus_fault() -> None:
    async def whole() -> None:
        async with can_rig(HOST) as rig:
            device = rig.driver("slcan", bus=f"slcan:{rig.wires.adapter.path}@500000")
            with pytest.raises(CellError, match="bit rate") as caught:
                await device.open()
            assert caught.value.name == "DEVICE_UNREACHABLE"

    asyncio.run(whole())


@pytest.mark.parametrize(
    ("said", "answers"),
    [
        ("< hi >", [b""]),
        ("instead of '< ok >'", [b"< hi >", b"< error could not open bus >"]),
        ("'< hi >' in time", []),
        ("closed", None),
    ],
)
def test_a_gateway_that_is_none_is_told_soon(said: str, answers: list[bytes] | None) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for answer in answers or ():
            writer.write(answer)
            await writer.drain()
            await asyncio.sleep(0.02)
        if answers is not None:
            await reader.read()
        writer.close()

    async def whole() -> None:
        server = await asyncio.start_server(serve, HOST, 0)
        async with server:
            port = server.sockets[0].getsockname()[1]
            config = CanopenEncoder.Config(bus=f"socketcand:{HOST}:{port}/can0", connect_timeout_s=0.3)
            device = CanopenEncoder("belt", config, MonotonicClock())
            begun = time.monotonic()
            with pytest.raises(CellError, match=said) as caught:
                await device.open()
            assert caught.value.name == "DEVICE_UNREACHABLE"
            assert time.monotonic() - begun < 2.0
        await asyncio.sleep(0.05)  # the other end sees the connection closed

    asyncio.run(whole())


def test_a_gateway_may_send_a_frame_along_with_its_answer() -> None:
    """python-can's own bus wants the answer alone, and so cannot be opened on a busy bus."""

    opened = asyncio.Event()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"< hi >")
        await reader.readuntil(b">")
        writer.write(b"< ok >")
        await reader.readuntil(b">")
        writer.write(b"< ok >< frame 321 5.000000 07000000 >< frame 321 5.0")
        await opened.wait()
        writer.write(b"05000 08000000 >")
        await reader.read()
        writer.close()

    async def whole() -> None:
        server = await asyncio.start_server(serve, HOST, 0)
        async with server:
            port = server.sockets[0].getsockname()[1]
            config = RawCanEncoderConfig(bus=f"socketcand:{HOST}:{port}/can0", id=0x321)
            device = RawCanEncoder("belt", config, MonotonicClock())
            second = asyncio.Event()
            device.counts.subscribe(lambda sample: second.set() if sample.value.raw == 8 else None)
            await device.open()
            opened.set()
            async with asyncio.timeout(2.0):
                await second.wait()
            assert [s.value.raw for s in device.counts.between(0.0, 1e12)] == [7, 8]
            await device.close()
        await asyncio.sleep(0.05)  # the other end sees the connection closed

    asyncio.run(whole())


def test_a_recording_has_a_gateways_bytes_at_the_time_that_the_drivers_work_with(tmp_path: Path) -> None:
    """Played again, a frame is as old as it was: a belt is forecast from these times."""
    heard: list[float] = []

    class Hearing:
        ids: Ids = ()

        def receive(self, messages: Sequence[can.Message], looked: float, now: float) -> None:
            heard.append(now)

        def hear_error_frame(self) -> None: ...
        def lose(self, why: str, bus_off: bool) -> None: ...

    async def whole() -> None:
        async with can_rig(HOST) as rig:
            listener = Hearing()
            listener.ids = [(rig.node.position_id, False)]
            bus = bus_at(parse_bus(rig.wires.buses["socketcand"]), MonotonicClock())
            device = rig.driver("socketcand")
            with recorded_by(recorder):
                await bus.join(listener, 2.0)
            await device.open()  # which starts the node
            await asyncio.sleep(0.3)
            await device.close()
            await bus.leave(listener)

    recorder = WireRecorder(tmp_path, 1 << 20)
    asyncio.run(whole())
    recorder.close()
    (subject,) = read_recording(tmp_path).of("socketcand")
    told = {record.t for record in subject.records if record.data.startswith(b"< frame") and not record.sent}
    assert len(heard) > 20
    assert set(heard) <= told


def test_a_bus_that_is_not_there_is_told_soon(tmp_path: Path) -> None:
    with socket.create_server((HOST, 0)) as free:
        port = free.getsockname()[1]

    async def whole() -> None:
        for bus in (
            f"socketcand:{HOST}:{port}/can0",
            f"slcan:{tmp_path}/nothing@250000",
            "socketcan:nosuchcan0",
        ):
            device = CanopenEncoder("belt", CanopenEncoder.Config(bus=bus), MonotonicClock())
            begun = time.monotonic()
            with pytest.raises(CellError, match=bus.partition("@")[0]) as caught:
                await device.open()
            assert caught.value.name == "DEVICE_UNREACHABLE"
            assert time.monotonic() - begun < 2.0

    asyncio.run(whole())


@pytest.mark.parametrize(
    ("keys", "data", "raw"),
    [
        ({"id": 0x321}, "07060504", 0x04050607),
        ({"id": 0x321, "offset_bytes": 2, "width_bits": 16, "byte_order": "big"}, "ffff0102", 0x0102),
        ({"id": 0x18FF0203, "extended": True, "width_bits": 24, "offset_bytes": 1}, "00010203", 0x030201),
        ({"id": 0x321, "width_bits": 16, "signed": True}, "feff", 65534),
        ({"id": 0x321, "width_bits": 16, "range_counts": 4000}, "9f0f", 3999),
    ],
)
def test_a_raw_position_is_cut_out_of_its_frame(
    interface: str, keys: dict[str, object], data: str, raw: int
) -> None:
    async def whole() -> None:
        async with can_rig(HOST) as rig:
            config = RawCanEncoderConfig.model_validate({"bus": rig.wires.buses[interface], **keys})
            device = RawCanEncoder("belt", config, MonotonicClock())
            port = rig.bus.join(lambda frame, t: None)
            third = asyncio.Event()
            device.counts.subscribe(lambda sample: third.set() if device.counts.received == 3 else None)
            await device.open()
            wanted = Frame(config.id, bytes.fromhex(data), config.extended)
            stranger = Frame(config.id ^ 1, bytes(8), config.extended)
            short = Frame(config.id, b"\x01", config.extended)
            async with asyncio.timeout(3.0):
                while not third.is_set():  # an adapter takes a moment to open its channel
                    for frame in (stranger, short, wanted):
                        port.send(frame, time.monotonic())
                    await asyncio.sleep(0.01)
            assert {s.value.raw for s in device.counts.between(0.0, 1e12)} == {raw}
            assert device.modulus == config.modulus
            await device.close()

    asyncio.run(whole())
