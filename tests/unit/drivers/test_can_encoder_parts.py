"""The parts of the CAN encoder's driver: places, counts, losses, stamps, words, requests."""

import asyncio
import random
import socket
import time
from collections.abc import Awaitable, Callable

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from cell.clock import MonotonicClock
from cell.devices import EncoderState
from cell.errors import CellError
from cell.samples import Sample
from drivers.can_bus.address import BusAddress, parse_bus
from drivers.can_encoder import RawCanEncoder
from drivers.can_encoder.config import CanopenEncoderConfig, RawCanEncoderConfig
from drivers.can_encoder.counts import Missing, Unwrap
from drivers.can_encoder.sdo import SdoAbort, SdoClient
from drivers.can_encoder.stamps import GatewayStamps, HostStamps, KernelStamps
from drivers.can_encoder.words import abort_words, emergency_words

pytestmark = pytest.mark.wire  # answers are waited for in real time

PERIOD = 0.005


# -- where a bus is


@pytest.mark.parametrize(
    ("bus", "place"),
    [
        ("socketcan:can0", BusAddress("socketcan", "can0")),
        ("slcan:/dev/ttyACM0@250000", BusAddress("slcan", "/dev/ttyACM0", bit_rate=250_000)),
        (
            "slcan:/dev/serial/by-id/x@500000?baudrate=2000000",
            BusAddress("slcan", "/dev/serial/by-id/x", bit_rate=500_000, baudrate=2_000_000),
        ),
        ("socketcand:127.0.0.2:29537/vcan0", BusAddress("socketcand", "vcan0", "127.0.0.2", 29537)),
        ("socketcand:gateway/can0", BusAddress("socketcand", "can0", "gateway", 29536)),
        ("socketcand:[::1]:29536/can0", BusAddress("socketcand", "can0", "::1", 29536)),
    ],
)
def test_a_bus_is_found_by_its_text(bus: str, place: BusAddress) -> None:
    assert parse_bus(bus) == place


@pytest.mark.parametrize(
    ("bus", "said"),
    [
        ("can0", "begin with socketcan:, slcan: or socketcand:"),
        ("slcan:/dev/ttyACM0", "behind the @"),
        ("slcan:ttyACM0@250000", "should be like slcan:/dev/ttyACM0@250000"),
        ("slcan:/dev/ttyACM0@9600", "no bit rate 9600"),
        ("socketcand:127.0.0.1:99999/can0", "1 to 65535"),
        ("socketcand:127.0.0.1", "should be like socketcand:host:29536/can0"),
        ("socketcan:", "should be like socketcan:can0"),
    ],
)
def test_a_bus_that_cannot_be_is_refused_with_its_right_form(bus: str, said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        CanopenEncoderConfig(bus=bus)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"id": 0x800}, "more than 11 bits"),
        ({"id": 1, "offset_bytes": 6, "width_bits": 32}, "go beyond 8 bytes"),
        ({"id": 1, "width_bits": 16, "range_counts": 70000}, "does not fit 16 bits"),
        ({"id": 1, "width_bits": 16, "range_counts": 4000, "signed": True}, "signed"),
        ({"id": 1, "period_s": 0.2}, "three times period_s"),
    ],
)
def test_a_raw_position_that_cannot_be_is_refused(keys: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        RawCanEncoderConfig.model_validate({"bus": "socketcan:can0", **keys})


def test_a_timer_of_canopen_has_whole_milliseconds() -> None:
    with pytest.raises(ValidationError, match="whole number of milliseconds"):
        CanopenEncoderConfig(bus="socketcan:can0", period_s=0.0025)


# -- counts


@given(
    st.integers(2, 1 << 32),
    st.lists(st.floats(-0.5, 0.5, exclude_min=True, exclude_max=True), min_size=1, max_size=40),
    st.integers(0, 1 << 32),
)
def test_counts_go_on_through_any_range(modulus: int, shares: list[float], first: int) -> None:
    subject, true = Unwrap(modulus), first
    assert subject.take(first % modulus) == 0
    for share in shares:
        true += int(share * modulus)
        assert subject.take(true % modulus) == true - first


def test_a_position_outside_the_range_is_refused() -> None:
    with pytest.raises(ValueError, match="outside 0 to 999"):
        Unwrap(1000).take(1000)


def losses(stamps: list[float]) -> int:
    subject = Missing(PERIOD)
    return sum(subject.add(t) for t in stamps)


def test_lost_frames_are_told_once() -> None:
    kept = [k * PERIOD for k in range(200) if k not in (50, 51, 52, 120)]
    assert losses(kept) == 4


def test_a_frame_that_comes_late_is_not_a_lost_one() -> None:
    stamps = [k * PERIOD for k in range(200)]
    stamps[60] += 0.8 * PERIOD
    for k in range(100, 106):  # a stall, and then all at once
        stamps[k] = 106 * PERIOD
    assert losses(stamps) == 0


def test_frames_that_scatter_by_most_of_a_period_are_all_there() -> None:
    generator = random.Random(4)
    stamps = sorted(k * PERIOD + generator.expovariate(1.0 / 0.002) for k in range(5000))
    assert losses(stamps) == 0
    assert 40 <= losses([t for k, t in enumerate(stamps) if k % 100 != 50]) <= 55


def test_a_long_stall_after_which_all_frames_come_is_no_loss() -> None:
    stamps = [k * PERIOD for k in range(300)]
    for k in range(100, 160):
        stamps[k] = 160 * PERIOD + (k - 100) * 1e-5
    assert losses(stamps) == 0


def test_a_sender_that_is_a_little_slow_or_fast_loses_nothing() -> None:
    for rate in (0.98, 1.02):
        assert losses([k * PERIOD * rate for k in range(2000)]) == 0


# -- stamps


class Monotonic:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.t = 100.0

    def now(self) -> float:
        return self.t

    async def sleep(self, seconds: float) -> None:
        self.t += seconds


def message(stamp: float = 0.0) -> can.Message:
    return can.Message(arbitration_id=1, timestamp=stamp)


def test_kernel_stamps_become_monotonic_though_the_wall_clock_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, wall = Monotonic(), 1.7e9
    monkeypatch.setattr(time, "time", lambda: wall)
    subject = KernelStamps(clock)
    ((t, dt, _),) = subject.take([message(wall - 0.003)], clock.t - 0.005, clock.t)
    assert t == pytest.approx(clock.t - 0.003, abs=1e-6)
    assert dt < 1e-3
    wall += 3600.0
    ((t, _, _),) = subject.take([message(wall - 0.002)], clock.t - 0.005, clock.t)
    assert t == pytest.approx(clock.t - 0.002, abs=1e-6)
    assert subject.refused == 0


def test_a_kernel_stamp_that_cannot_be_true_gives_way_to_the_arrival(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, wall = Monotonic(), 1.7e9
    monkeypatch.setattr(time, "time", lambda: wall)
    subject = KernelStamps(clock)
    for wrong in (wall - 3600.0, wall + 1.0):
        ((t, dt, _),) = subject.take([message(wrong)], clock.t - 0.004, clock.t)
        assert clock.t - 0.004 <= t <= clock.t
        assert dt >= 0.002
    assert subject.refused == 2


def test_a_gateways_stamps_keep_their_spacing_however_late_they_arrive() -> None:
    subject = GatewayStamps()
    delays = [0.0003 if k % 7 else 0.004 for k in range(400)]
    times = [
        subject.take([message(5000.0 + k * PERIOD)], 0.0, 100.0 + k * PERIOD + delay)[0][0]
        for k, delay in enumerate(delays)
    ]
    settled = [t - k * PERIOD for k, t in enumerate(times)][10:]
    assert max(settled) - min(settled) < 1e-6


def test_a_gateway_whose_clock_jumps_is_followed() -> None:
    subject = GatewayStamps()
    for k in range(100):
        subject.take([message(5000.0 + k * PERIOD)], 100.0 + (k - 1) * PERIOD, 100.0 + k * PERIOD)
    ((t, dt, _),) = subject.take([message(9000.0)], 100.495, 100.5)
    assert t == pytest.approx(100.5)
    assert dt == pytest.approx(0.0025)
    assert subject.refused == 1


def test_frames_found_together_came_one_after_the_other() -> None:
    subject = HostStamps(PERIOD)
    subject.take([message()], 99.995, 100.0)
    found = subject.take([message() for _ in range(4)], 100.0, 100.02)
    assert [stamp.t for stamp in found] == pytest.approx([100.005, 100.01, 100.015, 100.02])
    assert all(stamp.dt >= PERIOD / 2 and stamp.heard == 100.02 for stamp in found)


def test_the_time_of_an_arrival_is_as_doubtful_as_arrivals_lately_scattered() -> None:
    even, uneven = HostStamps(PERIOD), HostStamps(PERIOD)
    for k in range(50):
        late = 0.0015 if k % 5 == 0 else 0.0
        ((_, sure, _),) = even.take([message()], 0.0, 100.0 + k * PERIOD)
        ((_, doubtful, _),) = uneven.take([message()], 0.0, 100.0 + k * PERIOD + late)
    assert sure < 0.0005
    assert 0.001 < doubtful < 0.003


# -- socketcan, which not every machine has


class StubBus:
    """What the kernel would give: frames from a list, an error frame, a descriptor that is readable."""

    def __init__(self, messages: list[can.Message]) -> None:
        self.messages = messages
        self.ends = socket.socketpair()

    def fileno(self) -> int:
        return self.ends[0].fileno()

    def recv(self, timeout: float) -> can.Message | None:
        assert timeout == 0
        return self.messages.pop(0) if self.messages else None

    def shutdown(self) -> None:
        for end in self.ends:
            end.close()


def test_socketcan_is_opened_with_filters_and_an_error_frame_of_bus_off_ends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[dict[str, object]] = []

    def opened(**keys: object) -> StubBus:
        asked.append(keys)
        now = time.time()
        frames = [
            can.Message(arbitration_id=0x321, is_extended_id=False, data=bytes([k]), timestamp=now)
            for k in (1, 2)
        ]
        bus.messages += [*frames, can.Message(arbitration_id=0x40, is_error_frame=True, timestamp=now)]
        return bus

    bus = StubBus([])
    monkeypatch.setattr(can, "Bus", opened)

    async def scene() -> None:
        config = RawCanEncoderConfig(bus="socketcan:can7", id=0x321, width_bits=8)
        device = RawCanEncoder("belt", config, MonotonicClock())
        await device.open()
        samples: list[Sample[EncoderState]] = []
        device.counts.subscribe(samples.append)
        bus.ends[1].send(b"x")
        failure = await device.wait_lost()
        assert isinstance(failure, CellError)
        assert failure.name == "CAN_BUS_OFF"
        await device.close()
        assert [s.value.raw for s in samples] == [1, 2]
        assert all(abs(s.t - time.monotonic()) < 1.0 and s.dt < 0.001 for s in samples)

    asyncio.run(scene())
    (keys,) = asked
    assert keys["interface"] == "socketcan"
    assert keys["channel"] == "can7"
    assert keys["can_filters"] == [{"can_id": 0x321, "can_mask": 0x7FF, "extended": False}]


# -- words and requests


def test_codes_are_told_in_words_and_unknown_ones_by_their_number() -> None:
    assert abort_words(0x06010002) == "the object can only be read (abort code 06010002h)"
    assert abort_words(0x12345678) == "reason not known (abort code 12345678h)"
    assert emergency_words(0x8130, 0x11) == (
        "heartbeat or life guard of its master is missing (8130h; generic, communication)"
    )
    assert emergency_words(0x5017, 0) == "hardware of the device (5017h)"
    assert emergency_words(0xA123, 0) == "meaning not known (A123h)"


def ask(
    replies: list[bytes | None], work: Callable[[SdoClient], Awaitable[object]]
) -> tuple[object, list[bytes]]:
    """Let ``work`` ask a node that gives these replies in turn; what came out, and what was sent."""
    sent: list[bytes] = []

    async def whole() -> object:
        async def send(identifier: int, data: bytes) -> None:
            assert identifier == 0x605
            sent.append(data)
            reply = replies.pop(0) if replies else None
            if reply is not None:
                asyncio.get_running_loop().call_soon(client.receive, reply)

        client = SdoClient("belt", 5, send, 0.02)
        return await work(client)

    return asyncio.run(whole()), sent


def test_numbers_of_one_to_four_bytes_are_read() -> None:
    for head, data, value in (
        (0x4F, "05000000", 5),
        (0x4B, "34120000", 0x1234),
        (0x43, "78563412", 0x12345678),
        (0x42, "78563412", 0x12345678),
    ):
        reply = bytes([head, 0x02, 0x60, 0x00]) + bytes.fromhex(data)
        found, sent = ask([reply], lambda client: client.read(0x6002))
        assert found == value
        assert sent == [bytes.fromhex("4002600000000000")]


def test_a_reply_to_another_request_is_not_taken_for_ours() -> None:
    late = bytes.fromhex("4302180105000000")
    right = bytes.fromhex("4302600007000000")
    found, sent = ask([late, right], lambda client: client.read(0x6002))
    assert found == 7
    assert len(sent) == 2


def test_a_lost_reply_is_asked_for_again_and_silence_is_a_lost_device() -> None:
    found, sent = ask([None, bytes.fromhex("4302600007000000")], lambda client: client.read(0x6002))
    assert found == 7
    with pytest.raises(CellError, match="object 6002h:00h") as caught:
        ask([None, None], lambda client: client.read(0x6002))
    assert caught.value.name == "DEVICE_LOST"
    assert sent[0] == sent[1]


def test_a_refusal_is_told_with_object_and_reason() -> None:
    reply = bytes.fromhex("80181001") + (0x06090011).to_bytes(4, "little")
    with pytest.raises(SdoAbort, match="object 1018h:01h: there is no such sub-index") as caught:
        ask([reply], lambda client: client.read(0x1018, 1))
    assert caught.value.code == 0x06090011


def test_a_value_too_long_for_one_frame_is_declined() -> None:
    with pytest.raises(SdoAbort):
        _, sent = ask([bytes.fromhex("4108100010000000")], lambda client: client.read(0x1008))
        assert sent[-1][0] == 0x80


def test_a_write_has_its_size_in_the_request() -> None:
    for size, head in ((1, 0x2F), (2, 0x2B), (4, 0x23)):
        reply = bytes.fromhex("6017100000000000")
        _, sent = ask([reply], lambda client, size=size: client.write(0x1017, 0, 1, size))
        assert sent == [bytes([head, 0x17, 0x10, 0, 1, 0, 0, 0])]
