"""The GeoCOM driver against an instrument that refuses, is damaged on its way, or falls silent."""

import asyncio
import re
from collections.abc import Callable

import numpy as np
import pytest
from geocom_rig import Instrument, make, on_tcp, opened
from tracker_driver_scene import TRUTH, failure_of, found, play, subject, until

from cell.errors import CellError
from drivers.tracker import GeocomTracker

__all__ = ["subject"]
pytestmark = pytest.mark.wire


@pytest.mark.parametrize(
    ("rpc", "code", "name"),
    [
        (9037, 8710, "TRACKER_NO_TARGET"),
        (9037, 8711, "TRACKER_NO_TARGET"),
        (9037, 8704, "TRACKER_NO_TARGET"),
        (9013, 8725, "TRACKER_NO_TARGET"),
        (9037, 8707, "TRACKER_FAULT"),
        (9037, 16, "TRACKER_POWER"),
        (9037, 3081, "TRACKER_REFUSED"),
        (9037, 4711, "TRACKER_REFUSED"),
    ],
)
def test_what_a_search_ends_with_is_told_with_its_number(
    subject: Instrument, rpc: int, code: int, name: str
) -> None:
    subject.answers[rpc] = lambda p: str(code)
    told = play(subject, lambda t: failure_of(t.find(None, 1.0)))
    assert told.name == name
    assert str(code) in told.detail


@pytest.mark.parametrize(
    ("code", "name"), [(1290, "TRACKER_NOT_LEVEL"), (1291, "TRACKER_SETTING"), (14, "TRACKER_FAULT")]
)
def test_what_a_distance_ends_with_is_told_with_its_number(subject: Instrument, code: int, name: str) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        subject.answers[2167] = lambda p: str(code)
        told = await failure_of(tracker.measure(0.0, 1e-4, 1.0))
        assert told.name == name
        assert str(code) in told.detail
        subject.answers.clear()
        await tracker.measure(0.0, 1e-4, 1.0)

    play(subject, scene)


def test_an_instrument_that_is_busy_is_asked_again(subject: Instrument) -> None:
    busy = iter(["1293"] * 2)
    subject.answers[2167] = lambda p: next(busy, None) or subject._full()

    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        assert (await tracker.measure(0.0, 1e-4, 2.0)).value.count == 3

    play(subject, scene, tracking="off")


def test_a_search_that_takes_too_long_is_stopped_in_the_instrument(subject: Instrument) -> None:
    subject.delay_s[9037] = 0.6

    async def scene(tracker: GeocomTracker) -> None:
        told = await failure_of(tracker.find(None, 0.2))
        assert told.name == "TRACKER_NO_TARGET"
        assert "in 0.2 s" in told.detail
        await tracker.wait_fresh(1.0)
        assert subject.aborts == 1
        await asyncio.sleep(0.5)  # its reply comes now, and belongs to nobody
        await tracker.wait_fresh(1.0)
        assert tracker.health()["late"] == 1

    play(subject, scene)


Way = Callable[[bytes], list[bytes]]


def spoil(way: Way, rpc: int) -> Callable[[int, bytes], list[bytes] | None]:
    """Damage the next reply of ``rpc``, and no more."""
    left = iter([way])

    def damage(of: int, reply: bytes) -> list[bytes] | None:
        return way(reply) if of == rpc and next(left, None) is not None else None

    return damage


WAYS: dict[str, tuple[Way, str | None]] = {
    "silence": (lambda r: [], "timeouts"),
    "split": (lambda r: [r[:5], r[5:9], r[9:]], None),
    "joined with junk": (lambda r: [b"\x00\xffnoise\r\n" + r], "unreadable"),
    "wrong check sum": (lambda r: [r.replace(b":0", b":1", 1)], "unreadable"),
    "cut": (lambda r: [r[:14] + b"\r\n"], "unreadable"),
    "wrong number": (lambda r: [r.replace(b"%R1P,0,", b"%R1P,0,3", 1)], "unreadable"),
    "twice": (lambda r: [r, r], "late"),
    "request damaged": (lambda r: [b"%R1P,3078,0,29446:0\r\n"], None),
}
UNCHECKED: dict[str, Way] = {
    "silence": lambda r: [],
    "cut": lambda r: [r[:-12] + b"\r\n"],
    "a digit is none": lambda r: [re.sub(rb"\d\r", b"?\r", r)],
}


@pytest.mark.parametrize("way", WAYS)
def test_a_damaged_reply_costs_a_repetition_and_never_the_point(subject: Instrument, way: str) -> None:
    spoiled, counted = WAYS[way]

    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        subject.damage = spoil(spoiled, 2167)
        sample = await tracker.measure(0.0, 1e-4, 2.0)
        np.testing.assert_allclose(sample.value.point, TRUTH, atol=1e-12)
        assert counted is None or tracker.health()[counted] >= 1

    play(subject, scene, checksum=True, tracking="off", timeout_s=0.4, distance_timeout_s=0.1)


@pytest.mark.parametrize("way", UNCHECKED)
@pytest.mark.parametrize("rpc", [2167, 2023, 2029, 2008])
def test_one_bad_reply_without_check_sums_costs_a_repetition_however_long_a_distance_may_take(
    subject: Instrument, way: str, rpc: int
) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        subject.damage = spoil(UNCHECKED[way], rpc)
        sample = await tracker.measure(0.0, 1e-4, 2.0)
        np.testing.assert_allclose(sample.value.point, TRUTH, atol=1e-12)

        counts = tracker.health()
        assert counts["timeouts"] + counts["unreadable"] >= 1

    play(subject, scene, tracking="off", timeout_s=0.2, distance_timeout_s=60.0)


def test_a_distance_that_takes_longer_than_one_look_is_waited_for(subject: Instrument) -> None:
    looks = iter(["1285,0,0,0,0,0,0,0,0"])

    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        subject.delay_s[2167] = 1.1  # so long it waits before it says that there is none yet
        subject.answers[2167] = lambda p: next(looks, None) or subject._full()
        asked = asyncio.create_task(tracker.measure(0.0, 1e-4, 5.0))
        await until(lambda: len(subject.told(2167)) > 1)
        subject.delay_s.clear()
        np.testing.assert_allclose((await asked).value.point, TRUTH, atol=1e-12)

    play(subject, scene, tracking="off", distance_timeout_s=4.0)


def test_a_late_reply_is_not_taken_for_the_next(subject: Instrument) -> None:
    """Without check sums only the transaction's number can tell."""
    found_locked = iter(["0,1"])  # what the late reply says, and no other

    async def scene(tracker: GeocomTracker) -> None:
        await tracker.wait_fresh(2.0)
        subject.answers[6021] = lambda p: next(found_locked, "0,0")
        subject.delay_s[6021] = 0.5
        await until(lambda: tracker.health()["timeouts"] > 0)
        subject.delay_s.clear()
        await until(lambda: tracker.health()["late"] > 0)
        await tracker.wait_fresh(2.0)
        assert not tracker.health()["locked"]

    play(subject, scene, timeout_s=0.2, lost_after_failures=20)


def test_the_receiver_is_cleared_before_the_request_that_follows_an_error(subject: Instrument) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await tracker.wait_fresh(1.0)
        assert subject.raw.startswith(b"\n%R1Q")
        assert b"\n\n" not in subject.raw
        subject.damage = spoil(lambda r: [], 6021)
        await until(lambda: tracker.health()["timeouts"] > 0)
        await tracker.wait_fresh(2.0)
        assert subject.raw.count(b"\r\n\n%R1Q,6021") == 1

    play(subject, scene, timeout_s=0.4)


def test_an_instrument_that_falls_silent_ends_the_link(subject: Instrument) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await tracker.wait_fresh(1.0)
        subject.damage = lambda rpc, reply: []
        async with asyncio.timeout(2.0):
            told = await tracker.wait_lost()
        assert isinstance(told, CellError)
        assert told.name == "DEVICE_LOST"
        assert "no answer in 0.2 s" in told.detail

    play(subject, scene, timeout_s=0.2)


def test_a_dropped_connection_ends_the_link_and_whatever_waits_on_it(subject: Instrument) -> None:
    async def whole() -> None:
        async with on_tcp(subject) as (url, peers), opened(url) as tracker:
            await found(tracker)
            subject.delay_s[2167] = 5.0
            asyncio.get_running_loop().call_later(0.1, lambda: peers[0].transport.abort())
            async with asyncio.timeout(1.0):
                assert (await failure_of(tracker.measure(0.0, 1e-4, 4.0))).name == "DEVICE_LOST"
                assert (await tracker.wait_lost()).name == "DEVICE_LOST"  # type: ignore[attr-defined]
            subject.delay_s.clear()
            epoch = tracker.readings.epoch
            await tracker.open()
            assert tracker.readings.epoch == epoch + 1
            assert (await failure_of(tracker.measure(0.0, 1e-4, 1.0))).name == "TRACKER_SETTING"
            await found(tracker)
            await tracker.measure(0.0, 1e-4, 1.0)

    asyncio.run(whole())


def test_nobody_at_the_address_is_told_with_it() -> None:
    told = asyncio.run(failure_of(make("tcp://127.0.41.9:9").open()))
    assert told.name == "DEVICE_UNREACHABLE"
    assert "tcp://127.0.41.9:9" in told.detail


def test_a_serial_line_that_is_not_there_is_told_with_its_name() -> None:
    told = asyncio.run(failure_of(make("serial:///dev/ttyNOTHERE").open()))
    assert told.name == "DEVICE_UNREACHABLE"
    assert "/dev/ttyNOTHERE" in told.detail
