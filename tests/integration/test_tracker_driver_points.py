"""The line-points driver against a program on a real socket that measures a point when it is asked to."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cell.clock import MonotonicClock
from cell.errors import CellError
from drivers.tracker import LinePointConfig, LinePointTracker
from fakes.geocom import LineFaults
from fakes.lines.stream import LineStream
from fakes.world.scenario import Scenario
from fakes.world.tracker.lines_form import LinesForm
from fakes.world.world import World
from tests.integration.test_tracker_driver_lines import HOST, Sender, failure_of, lost, on_tcp

pytestmark = pytest.mark.wire

KEYS: dict[str, Any] = {
    "serial": "99994400001",
    "sigma0_m": 15e-6,
    "sigma_per_m": 6e-6,
    "reflectors": {"smr1": {}},
    "columns": {"x": 1, "y": 2, "z": 3, "u95": 4, "valid": 5},
    "valid_values": ["OK"],
    "length_unit": "mm",
    "request": "MEASURE\n",
}
Scene = Callable[[LinePointTracker, Sender], Coroutine[Any, Any, Any]]


class Mute(Sender):
    """A program that takes requests and never answers."""

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        await reader.read()
        writer.close()


def play(line: bytes, scene: Scene, mute: bool = False) -> Any:
    """A scene with the open driver and a program that answers each request with ``line``."""
    sender = Mute() if mute else Sender()
    sender.line, sender.answers, sender.delay_s = line, True, 0.05

    async def whole() -> Any:
        async with asyncio.timeout(10), on_tcp(sender) as url:
            tracker = LinePointTracker("tracker", LinePointConfig(url=url, **KEYS), MonotonicClock())
            await tracker.open()
            try:
                await tracker.wait_fresh(0.1)  # nothing came yet, and nothing has to
                await tracker.select("smr1")
                await tracker.find(np.array([0.0, 3.0, 4.0]), 0.1)
                return await scene(tracker, sender)
            finally:
                await tracker.close()

    return asyncio.run(whole())


def test_a_point_is_the_answer_to_one_request_with_the_senders_own_sigma() -> None:
    async def scene(tracker: LinePointTracker, sender: Sender) -> None:
        before = MonotonicClock().now()
        found = await tracker.measure(1.0, 0.0002, 5.0)
        assert found.value.point == pytest.approx([0.0, 3.0, 4.0])
        assert found.value.sigma_m == pytest.approx(5e-6)
        assert (found.value.count, found.value.scatter_m) == (1, 0.0)
        assert found.t - found.dt >= before
        assert 2.0 * found.dt >= 0.05, "it was measured between request and answer"
        await tracker.measure(1.0, 0.0002, 5.0)
        assert sender.requests == [b"MEASURE\n", b"MEASURE\n"]

    play(b"0.0,3000.0,4000.0,0.010,OK\r\n", scene)


@pytest.mark.parametrize(
    ("line", "name", "words"),
    [
        (
            b"0.0,3000.0,4000.0,0.500,OK\n",
            "TRACKER_UNSTABLE",
            "0.250 mm for its point; the limit is 0.200 mm",
        ),
        (b"0.0,3000.0,4000.0,0.010,BAD\n", "TRACKER_NO_TARGET", "the sender says 'BAD'"),
    ],
)
def test_a_point_that_is_no_good_is_told_and_can_be_asked_for_again(
    line: bytes, name: str, words: str
) -> None:
    async def scene(tracker: LinePointTracker, sender: Sender) -> None:
        failure = await failure_of(tracker.measure(1.0, 0.0002, 5.0))
        assert failure.name == name
        assert words in failure.detail
        sender.line = b"0.0,3000.0,4000.0,0.010,OK\n"
        assert (await tracker.measure(1.0, 0.0002, 5.0)).value.count == 1

    play(line, scene)


def test_an_answer_that_is_not_there_in_time_ends_the_link_lest_it_be_taken_for_the_next_one() -> None:
    async def scene(tracker: LinePointTracker, sender: Sender) -> None:
        failure = await failure_of(tracker.measure(1.0, 0.0002, 0.3))
        assert failure.name == "DEVICE_LOST"
        assert "the point that was asked for did not come in 0.3 s" in failure.detail
        assert (await lost(tracker)).name == "DEVICE_LOST"

    play(b"0.0,3000.0,4000.0,0.010,OK\n", scene, mute=True)


def test_a_measurement_that_is_given_up_leaves_no_answer_behind() -> None:
    async def scene(tracker: LinePointTracker, sender: Sender) -> None:
        task = asyncio.create_task(tracker.measure(1.0, 0.0002, 5.0))
        await asyncio.sleep(0.1)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert (await lost(tracker)).name == "DEVICE_LOST"

    play(b"0.0,3000.0,4000.0,0.010,OK\n", scene, mute=True)


def test_a_line_that_cannot_be_read_ends_the_link_with_its_reason() -> None:
    async def scene(tracker: LinePointTracker, sender: Sender) -> None:
        failure = await failure_of(tracker.measure(1.0, 0.0002, 5.0))
        assert failure.name == "PROTOCOL_VIOLATION"
        assert "its u95 is 'wide', which is no number" in failure.detail

    play(b"0.0,3000.0,4000.0,wide,OK\n", scene)


def test_a_point_that_nobody_asked_for_is_none() -> None:
    async def scene(tracker: LinePointTracker, sender: Sender) -> None:
        await tracker.measure(1.0, 0.0002, 5.0)
        sender.writers[0].write(b"9.0,9000.0,9000.0,0.010,OK\n")
        while not tracker.health()["unasked_lines"]:  # noqa: ASYNC110 -- nothing tells
            await asyncio.sleep(0.01)
        found = await tracker.measure(1.0, 0.0002, 5.0)
        assert found.value.point == pytest.approx([0.0, 3.0, 4.0])
        assert tracker.health()["unasked_lines"] == 1

    play(b"0.0,3000.0,4000.0,0.010,OK\n", scene)


def test_a_point_needs_the_reflector_that_it_was_measured_with() -> None:
    async def whole() -> CellError:
        async with on_tcp(Sender()) as url:
            tracker = LinePointTracker("tracker", LinePointConfig(url=url, **KEYS), MonotonicClock())
            await tracker.open()
            failure = await failure_of(tracker.measure(1.0, 0.0002, 5.0))
            await tracker.close()
            return failure

    assert asyncio.run(whole()).name == "TRACKER_SETTING"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"request": None}, "request is needed"),
        ({"min_readings": 5}, "min_readings is of readings that keep coming"),
        ({"columns": {"x": 1, "y": 2, "z": 3, "u95": 4, "sigma": 5}, "valid_values": []}, "not both"),
        ({"url": "serial:///dev/ttyUSB1?baudrate=9600"}, "give a tcp:// one"),
        ({"url": "udp://127.0.0.1:5000"}, "give a tcp:// one"),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        LinePointConfig(**{"url": "tcp://127.0.0.1:5000"} | KEYS | keys)


def test_a_twin_that_answers_requests_gives_the_point_where_the_reflector_is() -> None:
    async def scene() -> None:
        twin = World.from_scenario(Scenario.load("tracker:ideal"), time.monotonic()).tracker
        assert twin is not None
        text = "{x:.4f},{y:.4f},{z:.4f},0.060,{valid}\r\n"
        form = LinesForm(reflector="m1", text=text, valid="OK", request="MEASURE\n")
        stream = LineStream(twin, form.model_copy(update={"port": 0}), HOST, time.monotonic, LineFaults())
        await stream.start()
        host, port = stream.listener.addresses[0]
        tracker = LinePointTracker(
            "tracker", LinePointConfig(url=f"tcp://{host}:{port}", **KEYS), MonotonicClock()
        )
        try:
            await tracker.open()
            await tracker.select("smr1")
            found = (await tracker.measure(1.0, 0.0002, 5.0)).value
        finally:
            await tracker.close()
            await stream.stop()
            await asyncio.sleep(0)
        true = np.array(twin.visibility.local("m1", time.monotonic()))
        sigma = 15e-6 + 6e-6 * float(np.linalg.norm(true))
        np.testing.assert_allclose(found.point, true, atol=6 * sigma)
        assert found.sigma_m == pytest.approx(30e-6)

    asyncio.run(scene())
