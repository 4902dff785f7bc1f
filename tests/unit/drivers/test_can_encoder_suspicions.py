"""Frames that no single encoder at its timer sends are noticed, and ordinary ones are not."""

import asyncio
from collections.abc import Callable, Sequence

import can
import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.devices import Identity
from cell.errors import CellError
from drivers.can_encoder import CanopenEncoder, CanopenEncoderConfig, RawCanEncoder, RawCanEncoderConfig
from drivers.can_encoder.setup import NodeSetup
from drivers.can_encoder.suspicions import Flood, TwoSenders

PERIOD_S = 0.005
ID = 0x321
CLOCK = MonotonicClock()


@pytest.mark.parametrize("other", [0, 7, 3])
def test_two_nodes_on_one_identifier_are_seen_whatever_the_second_does(other: int) -> None:
    subject = TwoSenders()
    told = [subject.seen(10 * k if k % 2 else 50000 + other * k) for k in range(60)]
    assert any(told)


def test_a_belt_that_runs_stops_shakes_or_turns_back_is_one_sender() -> None:
    rng = np.random.default_rng(1)
    for speed in (0.0, 0.4, 30.0, 4000.0):
        subject, way = TwoSenders(), np.cumsum(np.full(2000, speed) * np.sin(np.arange(2000) / 100.0))
        shaken = way + rng.integers(-2, 3, 2000)
        assert not any(subject.seen(int(x)) for x in shaken), speed


def test_a_position_that_is_set_once_is_one_sender() -> None:
    subject = TwoSenders()
    assert not any(subject.seen(k if k < 100 else 50000 + k) for k in range(200))


def test_frames_by_the_timer_are_no_flood_and_those_with_every_count_are() -> None:
    by_timer, by_event = Flood(PERIOD_S), Flood(PERIOD_S)
    assert not any(by_timer.seen(k * PERIOD_S) for k in range(2000))
    told = [by_event.seen(k / 1500.0) for k in range(2000)]
    assert told[-1] == pytest.approx(1500.0, rel=0.01)


@pytest.mark.parametrize("stalled_s", [0.4, 1.5, 5.0])
def test_a_burst_after_a_stall_is_no_flood(stalled_s: float) -> None:
    subject = Flood(PERIOD_S)
    back = 1.0 + stalled_s
    times = [k * PERIOD_S for k in range(3000)]
    times = [t if not 1.0 < t < back else back for t in times]
    assert not any(subject.seen(t) for t in times)


def test_a_flood_is_one_also_after_a_stall() -> None:
    subject = Flood(PERIOD_S)
    before = [subject.seen(k * PERIOD_S) for k in range(200)]
    assert not any(before)
    told = [subject.seen(1.5 + k / 1500.0) for k in range(1500)]
    assert any(told), "within a second"


@pytest.mark.parametrize(("times", "within_s"), [(3.0, 2.1), (2.2, 10.1)])
def test_a_flood_is_told_the_later_the_less_it_is_one(times: float, within_s: float) -> None:
    subject = Flood(PERIOD_S)
    assert any(subject.seen(k * PERIOD_S / times) for k in range(round(within_s * times / PERIOD_S)))


def positions(t: float, counts: Sequence[int], apart_s: float = PERIOD_S) -> list[can.Message]:
    """Frames of 4 bytes from ``t`` on."""
    return [
        can.Message(
            timestamp=t + k * apart_s,
            arbitration_id=ID,
            is_extended_id=False,
            data=count.to_bytes(4, "little"),
        )
        for k, count in enumerate(counts)
    ]


async def opened() -> RawCanEncoder:
    """A driver that believes what it is handed; there is no bus."""
    device = RawCanEncoder("belt", RawCanEncoderConfig(bus="socketcan:can0", id=ID), CLOCK)
    device._life.begin()
    device.counts.new_epoch()
    device._start_counting()
    return device


def lost_by(frames: Callable[[float], Sequence[can.Message]]) -> CellError | None:
    """What ends the link when the frames come one at a time."""

    async def scene() -> CellError | None:
        device, now = await opened(), CLOCK.now()
        for message in frames(now):
            device._take([message], message.timestamp, message.timestamp)
        assert device.counts.last() is not None
        return device._life.failure

    return asyncio.run(scene())


def test_the_driver_ends_the_link_by_name_where_two_send_with_one_identifier() -> None:
    failure = lost_by(lambda t: positions(t, [50_000 if k % 2 else k for k in range(40)]))
    assert failure is not None
    assert failure.name == "ENCODER_TWO_SENDERS"
    assert "between two places" in failure.detail


def test_the_driver_ends_the_link_by_name_where_frames_come_with_every_count() -> None:
    failure = lost_by(lambda t: positions(t, range(3000), 1.0 / 1500.0))
    assert failure is not None
    assert failure.name == "ENCODER_FLOOD"


def test_the_driver_goes_on_with_one_encoder_at_its_timer() -> None:
    assert lost_by(lambda t: positions(t, range(0, 4000, 20))) is None


def test_frames_that_are_too_short_are_counted_and_named_when_positions_stay_away() -> None:
    async def scene() -> None:
        device, now = await opened(), CLOCK.now()
        whole, *short = positions(now, range(13))
        for message in short:
            message.data = message.data[:3]
        device._take([whole, *short], now, now)
        assert device.health()["too_short"] == 12
        silence = device._silence(now + 0.3, "")
        assert silence.name == "DEVICE_LOST"
        assert silence.detail.endswith("the last was 0; 12 frames were too short for a position")

    asyncio.run(scene())


def test_three_frames_that_a_canopen_node_cannot_send_end_its_link_by_name() -> None:
    async def scene() -> CellError | None:
        device = CanopenEncoder("belt", CanopenEncoderConfig(bus="socketcan:can0", node=5), CLOCK)
        device._life.begin()
        device._setup = NodeSetup(Identity("encoder", "1"), 1 << 32, slice(0, 4), None, False, False)
        device.counts.new_epoch()
        device._start_counting()
        now = CLOCK.now()
        for message in positions(now, range(3)):
            message.arbitration_id, message.data = device._config.position_id, message.data[:2]
            assert device._life.failure is None
            device._take([message], now, now)
        return device._life.failure

    failure = asyncio.run(scene())
    assert failure is not None
    assert failure.name == "PROTOCOL_VIOLATION"
    assert "have 2 bytes, the position needs 4" in failure.detail
