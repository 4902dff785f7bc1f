"""The line-stream driver against a sender on real sockets and a pseudo-terminal."""

import asyncio
import os
import socket
import time
import tty
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError
from drivers.tracker import LineStreamConfig, LineStreamTracker
from fakes.geocom import LineFaults
from fakes.lines.stream import LineStream
from fakes.world.scenario import Scenario
from fakes.world.tracker.lines_form import LinesForm
from fakes.world.world import World

pytestmark = pytest.mark.wire

HOST = "127.0.41.2"
KEYS: dict[str, Any] = {
    "serial": "99994400001",
    "sigma0_m": 15e-6,
    "sigma_per_m": 6e-6,
    "reflectors": {"smr1": {}, "big": {"constant_m": 0.2}},
    "pattern": r"(?P<x>\S+) (?P<y>\S+) (?P<z>\S+) (?P<valid>\w+)",
    "valid_values": ["OK"],
    "length_unit": "mm",
}
POINT = np.array([0.0, 3.0, 4.0])
GOOD = b"0.0 3000.0 4000.0 OK\r\n"
BAD = b"0 0 0 LOST\r\n"
Scene = Callable[[LineStreamTracker, "Sender"], Coroutine[Any, Any, Any]]


class Sender:
    """A program that sends ``line`` every ``period_s``, or, with ``answers``, for each request."""

    def __init__(self) -> None:
        self.line: bytes = GOOD
        self.period_s = 0.01
        self.answers = False
        self.delay_s = 0.0
        self.requests: list[bytes] = []
        self.writers: list[asyncio.StreamWriter] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        try:
            if self.answers:
                while line := await reader.readline():
                    self.requests.append(line)
                    await asyncio.sleep(self.delay_s)
                    writer.write(self.line)
            else:
                while True:
                    writer.write(self.line)
                    await writer.drain()
                    await asyncio.sleep(self.period_s)
        except ConnectionError:
            pass
        finally:
            writer.close()


@asynccontextmanager
async def on_tcp(sender: Sender) -> AsyncIterator[str]:
    server = await asyncio.start_server(sender.serve, HOST, 0)
    try:
        yield f"tcp://{HOST}:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        for writer in sender.writers:
            writer.transport.abort()
        await asyncio.sleep(0.05)


@asynccontextmanager
async def opened(url: str, **keys: Any) -> AsyncIterator[LineStreamTracker]:
    tracker = LineStreamTracker("tracker", LineStreamConfig(**{"url": url, **KEYS, **keys}), MonotonicClock())
    await tracker.open()
    try:
        yield tracker
    finally:
        await tracker.close()


@pytest.fixture
def subject() -> Sender:
    return Sender()


def play(sender: Sender, scene: Scene, **keys: Any) -> Any:
    """Runs a scene with the open driver on TCP."""

    async def whole() -> Any:
        async with asyncio.timeout(10), on_tcp(sender) as url, opened(url, **keys) as tracker:
            return await scene(tracker, sender)

    return asyncio.run(whole())


async def failure_of(what: Coroutine[Any, Any, Any]) -> CellError:
    with pytest.raises(CellError) as caught:
        await what
    return caught.value


async def lost(tracker: LineStreamTracker) -> CellError:
    async with asyncio.timeout(3.0):
        told = await tracker.wait_lost()
    assert isinstance(told, CellError)
    return told


def test_a_point_is_measured_from_lines_that_came_after_the_call(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        await tracker.select("smr1")
        await tracker.find(POINT, 1.0)
        asked = time.monotonic()
        sample = await tracker.measure(0.1, 1e-6, 2.0)
        np.testing.assert_allclose(sample.value.point, POINT, atol=1e-12)
        assert asked <= sample.t - sample.dt
        assert 0.1 <= sample.value.window_s <= time.monotonic() - asked + 0.02

    play(subject, scene)


def test_the_constant_of_the_selected_reflector_is_added(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        assert (await failure_of(tracker.measure(0.0, 1e-6, 1.0))).name == "TRACKER_SETTING"
        assert (await failure_of(tracker.select("smr9"))).name == "TRACKER_REFLECTOR_UNKNOWN"
        await tracker.select("big")
        sample = await tracker.measure(0.0, 1e-6, 2.0)
        np.testing.assert_allclose(sample.value.point, POINT * 1.04, atol=1e-12)

    play(subject, scene)


def test_a_reflector_that_is_elsewhere_is_not_found_and_its_distance_told(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        told = await failure_of(tracker.find(np.array([0.0, 3.0, 4.7]), 0.2))
        assert told.name == "TRACKER_NO_TARGET"
        assert "0.700 m away" in told.detail

    play(subject, scene)


def test_a_broken_beam_is_told_by_name_with_the_senders_words(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        await tracker.select("smr1")
        await tracker.find(POINT, 1.0)
        sender.line = BAD
        told = await failure_of(tracker.measure(0.2, 1e-6, 3.0))
        assert told.name == "TRACKER_BEAM_BROKEN"
        assert "LOST" in told.detail
        assert not tracker.readings.latest(1.0).value.locked
        assert (await failure_of(tracker.find(None, 0.1))).name == "TRACKER_NO_TARGET"
        sender.line = GOOD
        await tracker.find(POINT, 1.0)
        await tracker.measure(0.0, 1e-6, 2.0)

    play(subject, scene, broken_after_s=0.15)


def test_readings_that_wander_are_unstable(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        await tracker.select("smr1")

        async def wander() -> None:
            for k in range(1000):
                sender.line = b"%d 3000 4000 OK\n" % k
                await asyncio.sleep(0.005)

        task = asyncio.create_task(wander())
        told = await failure_of(tracker.measure(0.1, 1e-4, 0.5))
        task.cancel()
        assert told.name == "TRACKER_UNSTABLE"
        assert "limit is 0.100 mm" in told.detail

    play(subject, scene)


def test_lines_that_cannot_be_read_are_counted_and_told_and_change_nothing(
    subject: Sender, caplog: pytest.LogCaptureFixture
) -> None:
    subject.line = b"garbage\n" + GOOD

    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        await tracker.select("smr1")
        sample = await tracker.measure(0.05, 1e-6, 2.0)
        np.testing.assert_allclose(sample.value.point, POINT, atol=1e-12)
        health = tracker.health()
        assert health["bad_lines"] >= health["lines"] - 1 > 0
        assert health["bad_reason"] == "it does not match the pattern"

    play(subject, scene)
    assert "b'garbage'" in caplog.text


def test_too_many_lines_that_cannot_be_read_end_the_link(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        sender.line = b"garbage\n"
        told = await lost(tracker)
        assert told.name == "PROTOCOL_VIOLATION"
        assert "does not match the pattern" in told.detail

    play(subject, scene)


def test_a_sender_of_something_else_is_unreachable_and_why(subject: Sender) -> None:
    subject.line = b"hello\n"
    told: list[CellError] = []

    async def whole() -> None:
        async with on_tcp(subject) as url:
            told.append(await failure_of(opened(url, silence_s=0.3, lost_after_bad=1000).__aenter__()))

    asyncio.run(whole())
    assert told[0].name == "DEVICE_UNREACHABLE"
    assert "does not match the pattern" in told[0].detail


def test_a_sender_that_hangs_up_at_once_is_told_without_waiting(subject: Sender) -> None:
    subject.line = b""

    async def whole() -> None:
        async with on_tcp(subject) as url:
            asyncio.get_running_loop().call_later(0.2, lambda: subject.writers[0].transport.abort())
            async with asyncio.timeout(5.0):
                told = await failure_of(opened(url, silence_s=60.0).__aenter__())
            assert told.name == "DEVICE_LOST"

    asyncio.run(whole())


def test_a_silent_sender_ends_the_link(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        sender.line = b""
        assert "no line for 0.3 s" in (await lost(tracker)).detail

    play(subject, scene, silence_s=0.3)


def test_a_dropped_connection_ends_the_link_and_a_measurement_at_once(subject: Sender) -> None:
    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        await tracker.select("smr1")
        asyncio.get_running_loop().call_later(0.1, lambda: sender.writers[0].transport.abort())
        async with asyncio.timeout(2.0):
            assert (await failure_of(tracker.measure(60.0, 1e-6, 60.0))).name == "DEVICE_LOST"
        epoch = tracker.readings.epoch
        await tracker.open()
        assert tracker.readings.epoch == epoch + 1
        await tracker.wait_fresh(1.0)

    play(subject, scene)


def test_an_answer_to_a_request_lies_between_both(subject: Sender) -> None:
    subject.answers, subject.delay_s = True, 0.03

    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        await tracker.select("smr1")
        sample = await tracker.measure(0.0, 1e-6, 3.0)
        np.testing.assert_allclose(sample.value.point, POINT, atol=1e-12)
        assert set(sender.requests) == {b"GET\r\n"}
        assert tracker.readings.latest(1.0).dt >= 0.015
        sender.line = GOOD + GOOD
        await tracker.wait_fresh(1.0)
        await tracker.wait_fresh(1.0)
        assert tracker.health()["unasked_lines"] >= 1

    play(subject, scene, request="GET\r\n", poll_period_s=0.02)


def test_a_request_without_an_answer_ends_the_link(subject: Sender) -> None:
    subject.answers = True

    async def scene(tracker: LineStreamTracker, sender: Sender) -> None:
        sender.line = b""
        assert (await lost(tracker)).name == "DEVICE_LOST"

    play(subject, scene, request="GET\r\n", poll_period_s=0.02, silence_s=0.3)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def test_datagrams_are_lines_and_those_of_others_are_not_taken() -> None:
    async def whole() -> None:
        port = free_port()
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as friend,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
        ):
            friend.bind((HOST, 0))
            stranger.bind(("127.0.41.3", 0))

            async def send() -> None:
                while True:
                    friend.sendto(GOOD.strip(), (HOST, port))
                    stranger.sendto(b"9999 9999 9999 OK", (HOST, port))
                    await asyncio.sleep(0.01)

            task = asyncio.create_task(send())
            try:
                async with opened(f"udp://{HOST}:{port}", only_from=HOST) as tracker:
                    await tracker.select("smr1")
                    sample = await tracker.measure(0.1, 1e-6, 2.0)
            finally:
                task.cancel()
        np.testing.assert_allclose(sample.value.point, POINT, atol=1e-12)

    asyncio.run(whole())


def test_a_serial_line_is_read_until_its_plug_is_pulled() -> None:
    async def whole() -> None:
        ours, theirs = os.openpty()
        tty.setraw(theirs)

        async def send() -> None:
            while True:
                os.write(ours, GOOD)
                await asyncio.sleep(0.01)

        task = asyncio.create_task(send())
        try:
            async with opened(f"serial://{os.ttyname(theirs)}?baudrate=115200") as tracker:
                await tracker.select("smr1")
                sample = await tracker.measure(0.1, 1e-6, 2.0)
                np.testing.assert_allclose(sample.value.point, POINT, atol=1e-12)
                task.cancel()
                os.close(ours)
                os.close(theirs)
                assert (await lost(tracker)).name == "DEVICE_LOST"
        finally:
            task.cancel()

    asyncio.run(whole())


FORMS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "millimetres in columns": (
        {"text": "{n},{t:.3f},{x:.4f},{y:.4f},{z:.4f},{valid}\r\n", "heading": "n,t,x,y,z,valid\r\n"},
        {
            "columns": {"x": 3, "y": 4, "z": 5, "valid": 6},
            "valid_values": ["1"],
            "length_unit": "mm",
            "ignore": "n,t,.*",
        },
    ),
    "a station's angles, asked for": (
        {
            "text": "{serial} {hz:.7f} {v:.7f} {range:.6f}\r\n",
            "length_unit": "m",
            "angle_unit": "gon",
            "request": "?\r\n",
        },
        {
            "columns": {"serial": 1, "hz": 2, "v": 3, "range": 4},
            "delimiter": " ",
            "length_unit": "m",
            "angle_unit": "gon",
            "horizontal": "clockwise",
            "vertical": "zenith",
            "request": "?\r\n",
            "poll_period_s": 0.02,
        },
    ),
    "northing first": (
        {"text": "N={y:.6f} E={x:.6f} H={z:.6f} {temperature_c:.1f}\r\n", "length_unit": "in"},
        {
            "pattern": r"N=(?P<x>\S+) E=(?P<y>\S+) H=(?P<z>\S+) (?P<temperature_c>\S+)",
            "length_unit": "in",
            "axes": ["y", "x", "z"],
            "left_handed": True,
        },
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_twins_lines_are_read_as_the_points_they_are(form: str) -> None:
    theirs, ours = FORMS[form]
    keys = {k: v for k, v in KEYS.items() if k not in ("pattern", "valid_values")} | ours

    async def whole() -> None:
        tracker = World.from_scenario(Scenario.load("tracker:ideal"), time.monotonic()).tracker
        assert tracker is not None
        any_port = LinesForm(reflector="m1", period_s=0.02, **theirs).model_copy(update={"port": 0})
        stream = LineStream(tracker, any_port, HOST, time.monotonic, LineFaults())
        await stream.start()
        host, port = stream.listener.addresses[0]
        config = LineStreamConfig(url=f"tcp://{host}:{port}", **keys)
        device = LineStreamTracker("tracker", config, MonotonicClock())
        try:
            await device.open()
            true = np.array(tracker.visibility.local("m1", time.monotonic()))
            await device.select("smr1")
            await device.find(true, 2.0)
            value = (await device.measure(0.2, 1e-3, 3.0)).value
            sigma = 15e-6 + 6e-6 * float(np.linalg.norm(true))
            np.testing.assert_allclose(value.point, true, atol=6 * sigma)
            assert (await device.identify()).serial == tracker.truth.serial
        finally:
            await device.close()
            await stream.stop()
            await asyncio.sleep(0)

    asyncio.run(whole())
