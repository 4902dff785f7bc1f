"""The GeoCOM driver against a scripted instrument on real sockets and a pseudo-terminal."""

import asyncio
import math
import re
import time
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from geocom_rig import SERIAL, Instrument, make, on_pty, on_tcp, opened
from geocompy.communication import open_serial, open_socket
from geocompy.geo import GeoCom

from cell.errors import CellError
from cell.samples import Quality
from drivers.tracker import GeocomTracker

pytestmark = pytest.mark.wire

TRUTH = np.array([3 * math.sin(1.4) * math.sin(0.3), 3 * math.sin(1.4) * math.cos(0.3), 3 * math.cos(1.4)])
Scene = Callable[[GeocomTracker], Coroutine[Any, Any, Any]]


@pytest.fixture
def subject() -> Instrument:
    return Instrument()


def play(instrument: Instrument, scene: Scene, **keys: Any) -> Any:
    """Runs a scene with the open driver on TCP."""

    async def whole() -> Any:
        async with asyncio.timeout(10), on_tcp(instrument) as (url, _), opened(url, **keys) as tracker:
            return await scene(tracker)

    return asyncio.run(whole())


async def found(tracker: GeocomTracker) -> None:
    await tracker.select("smr1")
    await tracker.find(None, 2.0)


async def failure_of(what: Coroutine[Any, Any, Any]) -> CellError:
    with pytest.raises(CellError) as caught:
        await what
    return caught.value


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(5.0):
        while not true():  # noqa: ASYNC110 -- nothing tells
            await asyncio.sleep(0.01)


def test_an_instrument_says_who_it_is(subject: Instrument) -> None:
    identity = play(subject, lambda t: t.identify())
    assert (identity.model, identity.serial, identity.version) == ("TS60 test", SERIAL, "8.10.2")
    assert identity.is_twin
    assert subject.told(107) == [["15"]]


def test_opening_neither_turns_the_instrument_nor_switches_anything_on(subject: Instrument) -> None:
    play(subject, lambda t: t.wait_fresh(1.0))
    assert not {9013, 9018, 9020, 9027, 9037, 2008} & {rpc for rpc, _ in subject.asked}


@pytest.mark.parametrize(
    "keys", [{}, {"reading": "simple"}, {"checksum": True}, {"measure_with": "tracking"}]
)
def test_a_point_is_measured(subject: Instrument, keys: dict[str, Any]) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        asked = time.monotonic()
        await found(tracker)
        sample = await tracker.measure(0.02, 1e-4, 2.0)
        np.testing.assert_allclose(sample.value.point, TRUTH, atol=1e-12)
        assert sample.t - sample.dt >= asked
        assert sample.t + sample.dt <= time.monotonic()
        assert sample.value.count >= 3
        assert sample.value.window_s == pytest.approx(2 * sample.dt)
        assert sample.value.scatter_m < 1e-12
        assert (sample.value.temperature_c, sample.value.pressure_pa) == (21.5, 101325.0)
        assert sample.value.warnings == ()

    play(subject, scene, **keys)


def test_every_distance_of_a_point_is_begun_after_the_call(subject: Instrument) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        begun = len(subject.asked)
        count = (await tracker.measure(0.0, 1e-4, 2.0)).value.count
        programs = [p[0] for rpc, p in subject.asked[begun:] if rpc == 2008]
        assert programs[: 2 * count] == ["3", "1"] * count

    play(subject, scene)


def test_coordinates_are_taken_less_the_station(subject: Instrument) -> None:
    e, n, h = (TRUTH + np.array([100.0, 200.0, 10.0 + 1.5 - 0.1])).tolist()
    subject.answers[2082] = lambda p: f"0,{e!r},{n!r},{h!r},{len(subject.asked)},0,0,0,0"

    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        sample = await tracker.measure(0.0, 1e-4, 2.0)
        np.testing.assert_allclose(sample.value.point, TRUTH, atol=1e-12)

    play(subject, scene, reading="coordinates")


def test_the_telescope_is_turned_to_where_the_reflector_is_expected(subject: Instrument) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await tracker.select("smr1")
        await tracker.find(TRUTH, 2.0)

    play(subject, scene)
    hz, v = (float(x) for x in subject.told(9027)[0][:2])
    assert (hz, v) == pytest.approx((0.3, 1.4), abs=1e-14)
    order = [rpc for rpc, _ in subject.asked if rpc in (9020, 9027, 9018, 9037, 9013)]
    assert order == [9020, 9027, 9018, 9037, 9020, 9013]


def test_the_prism_constant_is_written_and_read_back(subject: Instrument) -> None:
    play(subject, lambda t: t.select("big"))
    assert subject.prism == -0.0344


def test_a_prism_constant_that_does_not_read_back_is_refused_with_both_numbers(subject: Instrument) -> None:
    subject.answers[2024] = lambda p: "0"  # as one that takes millimetres does: -0.0000344 m
    subject.prism = -0.0000344

    async def scene(tracker: GeocomTracker) -> None:
        told = await failure_of(tracker.select("big"))
        assert told.name == "TRACKER_SETTING"
        assert "-0.034 mm" in told.detail
        assert "-34.400 mm" in told.detail
        assert (await failure_of(tracker.measure(0.1, 1e-3, 1.0))).name == "TRACKER_SETTING"

    play(subject, scene)


def test_a_prism_constant_that_is_changed_at_the_panel_gives_no_point(subject: Instrument) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        await tracker.measure(0.0, 1e-4, 2.0)
        subject.prism = 0.01
        told = await failure_of(tracker.measure(0.0, 1e-4, 2.0))
        assert told.name == "TRACKER_SETTING"
        assert "10.000 mm" in told.detail
        assert tracker.health()["reflector"] is None
        subject.prism = 0.0
        assert (await failure_of(tracker.measure(0.0, 1e-4, 2.0))).name == "TRACKER_SETTING"
        await tracker.select("smr1")
        await tracker.measure(0.0, 1e-4, 2.0)

    play(subject, scene)


def test_a_reflector_that_the_config_does_not_have_is_told_by_name(subject: Instrument) -> None:
    told = play(subject, lambda t: failure_of(t.select("smr2")))
    assert told.name == "TRACKER_REFLECTOR_UNKNOWN"
    assert "smr1, big, but not 'smr2'" in told.detail


@pytest.mark.parametrize("code", [1283, 1284])
def test_data_that_the_instrument_doubts_are_used_and_told(subject: Instrument, code: int) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        subject.rc = code
        sample = await tracker.measure(0.0, 1e-4, 2.0)
        assert len(sample.value.warnings) == 1
        assert str(code) in sample.value.warnings[0]
        last = tracker.readings.latest(1.0)
        assert last.quality is Quality.DEGRADED
        assert last.value.point is not None

    play(subject, scene)


def test_a_lost_beam_is_told_by_name_and_measured_again_after_a_search(subject: Instrument) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        await tracker.measure(0.0, 1e-4, 2.0)
        subject.present = False
        told = await failure_of(tracker.measure(0.0, 1e-4, 2.0))
        assert told.name == "TRACKER_BEAM_BROKEN"
        assert "1285 TMC_ANGLE_OK" in told.detail
        assert (await failure_of(tracker.find(None, 1.0))).name == "TRACKER_NO_TARGET"
        assert (await failure_of(tracker.measure(0.0, 1e-4, 2.0))).name == "TRACKER_NO_TARGET"
        subject.present = True
        await tracker.find(None, 1.0)
        np.testing.assert_allclose((await tracker.measure(0.0, 1e-4, 2.0)).value.point, TRUTH, atol=1e-12)

    play(subject, scene)


def test_the_stream_shows_points_while_locked_and_none_when_the_beam_is_lost(subject: Instrument) -> None:
    async def scene(tracker: GeocomTracker) -> None:
        await tracker.wait_fresh(1.0)
        assert tracker.readings.latest(1.0).value.point is None
        await found(tracker)
        await tracker.wait_fresh(1.0)
        seen = tracker.readings.latest(1.0).value
        assert seen.locked
        np.testing.assert_allclose(seen.point, TRUTH, atol=1e-12)
        subject.present = False
        await tracker.wait_fresh(1.0)
        await tracker.wait_fresh(1.0)
        seen = tracker.readings.latest(1.0).value
        assert (seen.point, seen.locked) == (None, False)

    play(subject, scene)


def test_readings_that_wander_are_unstable_with_figures(subject: Instrument) -> None:
    subject.step_m = 1e-3

    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        told = await failure_of(tracker.measure(0.0, 1e-4, 0.3))
        assert told.name == "TRACKER_UNSTABLE"
        assert "0.816 mm RMS" in told.detail  # of three readings one millimetre apart
        assert "limit is 0.100 mm" in told.detail

    play(subject, scene)


def test_a_reflector_that_comes_to_rest_is_measured_from_then_on(subject: Instrument) -> None:
    subject.step_m = 1e-3

    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        asyncio.get_running_loop().call_later(0.1, lambda: setattr(subject, "step_m", 0.0))
        sample = await tracker.measure(0.0, 1e-6, 3.0)
        assert np.linalg.norm(sample.value.point) == pytest.approx(subject.slope, abs=1e-9)

    play(subject, scene)


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


@pytest.mark.parametrize("checksum", [False, True])
def test_a_point_is_measured_over_a_pseudo_terminal_until_its_plug_is_pulled(
    subject: Instrument, checksum: bool
) -> None:
    async def whole() -> None:
        async with on_pty(subject) as (url, unplug), opened(url, checksum=checksum) as tracker:
            await found(tracker)
            np.testing.assert_allclose((await tracker.measure(0.0, 1e-4, 2.0)).value.point, TRUTH, atol=1e-12)
            await unplug()
            async with asyncio.timeout(1.0):
                assert (await tracker.wait_lost()).name == "DEVICE_LOST"  # type: ignore[attr-defined]

    asyncio.run(whole())


@pytest.mark.parametrize("line", ["tcp", "pty"])
def test_geocompy_and_the_driver_read_the_same_from_one_instrument(subject: Instrument, line: str) -> None:
    """geocompy, which is not ours, is content with the instrument that the driver is tested on."""

    def theirs(url: str) -> tuple[Any, ...]:
        address = url.partition("://")[2].partition("?")[0]
        host, _, port = address.partition(":")
        with open_socket(host, int(port), "tcp") if port else open_serial(address) as connection:
            station = GeoCom(connection, checksum=True)
            station.tmc.do_measurement("DISTANCE")
            hz, v, slope = station.tmc.get_simple_measurement(1).params or (0, 0, 0)
            return (
                station.csv.get_serial_number().params,
                station.csv.get_instrument_name().params,
                (float(hz), float(v), slope),
                station.tmc.get_atmospheric_corrections().params,
            )

    async def whole() -> None:
        on = on_tcp if line == "tcp" else on_pty
        async with on(subject) as (url, _):  # type: ignore[operator]
            serial, name, polar, air = await asyncio.to_thread(theirs, url)
            async with opened(url, checksum=True) as tracker:
                identity = await tracker.identify()
                await found(tracker)
                value = (await tracker.measure(0.0, 1e-4, 2.0)).value
            assert (identity.serial, identity.model) == (str(serial), name)
            assert polar == pytest.approx((subject.hz, subject.v, subject.slope))
            np.testing.assert_allclose(value.point, TRUTH, atol=1e-12)
            assert (value.temperature_c, value.pressure_pa) == (air[2], 100 * air[1])

    asyncio.run(whole())


def test_the_stream_goes_on_with_points_after_a_single_measurement(subject: Instrument) -> None:
    """Single distances end tracking; the first distance of the next tracking is waited for."""
    waits: list[int] = []

    def first_distance_takes_a_while(parameters: list[str]) -> str:
        waits.append(int(parameters[0]))
        return subject._full() if waits[0] > 100 else "1285,0,0,0,0,0,0,0,0"

    async def scene(tracker: GeocomTracker) -> None:
        await found(tracker)
        await tracker.measure(0.0, 1e-4, 2.0)
        subject.answers[2167] = first_distance_takes_a_while
        begin = time.monotonic()
        for _ in range(3):
            await tracker.wait_fresh(2.0)
        seen = tracker.readings.between(begin, time.monotonic())
        assert len(seen) >= 3
        assert all(s.value.point is not None for s in seen)

    play(subject, scene)
