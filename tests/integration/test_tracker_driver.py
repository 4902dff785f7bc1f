"""The GeoCOM driver against a scripted instrument: what it measures, and what it says of it."""

import asyncio
import time
from typing import Any

import numpy as np
import pytest
from geocom_rig import SERIAL, Instrument, on_pty, on_tcp, opened
from geocompy.communication import open_serial, open_socket
from geocompy.geo import GeoCom
from tracker_driver_scene import TRUTH, failure_of, found, play, subject

from cell.samples import Quality
from drivers.tracker import GeocomTracker

__all__ = ["subject"]
pytestmark = pytest.mark.wire


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
