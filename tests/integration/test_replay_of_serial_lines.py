"""Serial lines of a recording, played to the drivers again: they read what they read from the twin.

Each is recorded on a pseudo-terminal of the twin's, which is gone when its recording is played. A kernel
hands on what is written to a terminal in its own time, so both are in real time, and what is compared has no
times.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.wire_recording.reader import Connection, Record, WireRecording, read_recording
from cell.wire_recording.tap import recorded_by
from cell.wire_recording.writer import WireRecorder
from drivers.can_encoder import CanopenEncoder, CanopenEncoderConfig
from drivers.modbus_inputs import InputsConfig, ModbusInputs
from drivers.tracker import GeocomConfig, GeocomTracker
from fakes.geocom import Instrument, StationWires
from fakes.replay.dialects import rtu_reply, rtu_request
from fakes.replay.player import WirePlayer, moved
from fakes.replay.serial_lines import serial_line
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.can_rig import NODE, can_rig
from tests.kit.ideal_world import prompt_station
from tests.kit.modbus_io_rig import Pulses, rig

pytestmark = pytest.mark.wire
HOST = "127.0.24.1"
REFLECTORS: Any = {"smr1": {"constant_m": 0.0}}
SCATTER_M = 1e-4  # of single distances and angles of the twin at 2 m it is a tenth of this
Use = Callable[[str], Awaitable[Any]]  # of a line, by its path: what a driver read on it


async def recorded(folder: Path, use: Use, line: str) -> tuple[Any, WireRecording]:
    recorder = WireRecorder(folder / "recording", 1 << 24)
    with recorded_by(recorder):
        found = await use(line)
    recorder.close()
    return found, read_recording(folder / "recording")


async def played(folder: Path, use: Use, recording: WireRecording) -> Any:
    """On a line of the same name in a folder of the player's."""
    lines = folder / "lines"
    lines.mkdir()
    (line,) = {serial_line(one.protocol, one.peer) for one in recording.connections}
    assert line is not None
    now = moved(recording, time.monotonic() - recording.begin)
    async with WirePlayer(now, MonotonicClock(), lines):
        found = await use(str(lines / line.name))
    assert not any(lines.iterdir()), "the player takes its lines away"
    return found


def test_an_encoder_on_a_serial_adapter_counts_the_same(tmp_path: Path) -> None:
    async def use(line: str) -> list[int]:
        config = CanopenEncoderConfig(bus=f"slcan:{line}@250000", node=NODE, lost_after_s=2.0)
        device, counts = CanopenEncoder("belt", config, MonotonicClock()), list[int]()
        device.counts.subscribe(lambda sample: counts.append(sample.value.count))
        await device.open()
        await device.wait_fresh(5.0)
        await asyncio.sleep(0.5)
        await device.close()
        return counts

    async def whole() -> None:
        async with can_rig(HOST) as twin:
            line = twin.wires.buses["slcan"].partition(":")[2].partition("@")[0]
            counts, recording = await recorded(tmp_path, use, line)
        subject = await played(tmp_path, use, recording)
        both = min(len(counts), len(subject))  # the end of either is where its driver let go
        assert both > 50
        assert subject[:both] == counts[:both]

    asyncio.run(whole())


def test_an_input_module_on_a_serial_line_reads_the_same(tmp_path: Path) -> None:
    async def use(line: str) -> tuple[str, list[tuple[Any, ...]]]:
        config = InputsConfig.model_validate(
            {
                "url": f"rtu://{line}?baudrate=115200",
                "module": "ioLogik-E1210",
                "inputs": {"xs": {"address": 0}, "ys": {"address": 1}},
                "poll_period_s": 0.02,
                "timeout_s": 2.0,  # for a machine that pauses
            }
        )
        device, read = ModbusInputs("beams", config, MonotonicClock()), list[tuple[Any, ...]]()
        device.inputs.subscribe(lambda sample: read.append((sample.value.levels, sample.value.changes)))
        await device.open()
        serial = (await device.identify()).serial
        await asyncio.sleep(0.8)
        await device.close()
        return serial, read

    async def whole() -> None:
        line = tmp_path / "io.tty"
        async with rig("ioLogik-E1210", Pulses(period=0.11, width=0.03), line=line):
            (serial, read), recording = await recorded(tmp_path, use, str(line))
        again, subject = await played(tmp_path, use, recording)
        both = min(len(read), len(subject))
        assert both > 10
        assert (again, subject[:both]) == (serial, read[:both])
        assert len(set(map(str, read[:both]))) > 2, "what was read was always the same"

    asyncio.run(whole())


def test_a_station_on_a_serial_line_measures_the_same_also_after_it_was_opened_anew(tmp_path: Path) -> None:
    world = World.from_scenario(Scenario.parse(prompt_station()), time.monotonic())
    tracker = world.tracker
    assert tracker is not None
    near = tracker.visibility.local("smr1", time.monotonic())

    async def use(line: str) -> list[Any]:
        found: list[Any] = []
        for _ in range(2):
            # No poll in between, of which a machine that pauses makes one more or less.
            config = GeocomConfig(
                url=f"serial://{line}?baudrate=115200", reflectors=REFLECTORS, poll_period_s=5.0
            )
            device = GeocomTracker("tracker", config, MonotonicClock())
            await device.open()
            found.append((await device.identify()).serial)
            await device.select("smr1")
            await device.find(near, 10.0)
            found.append((await device.measure(0.3, 1e-3, 10.0)).value.point)
            await device.close()
        return found

    async def whole() -> None:
        line = tmp_path / "tracker.tty"
        twin = StationWires(Instrument(tracker, time.monotonic), (), line)
        await twin.start()
        try:
            found, recording = await recorded(tmp_path, use, str(line))
        finally:
            await twin.stop()
        assert len(recording.of("tracker")) == 2
        subject = await played(tmp_path, use, recording)
        assert subject[::2] == found[::2]
        # In real time a window may hold one distance more or less: that moves their mean by their scatter.
        np.testing.assert_allclose(subject[1::2], found[1::2], rtol=0.0, atol=SCATTER_M)

    asyncio.run(whole())


@pytest.mark.parametrize("dangling", [False, True])
def test_a_line_that_is_there_is_left_alone(tmp_path: Path, dangling: bool) -> None:
    line = tmp_path / "ttyUSB0"
    if dangling:
        line.symlink_to(tmp_path / "unplugged")
    else:
        line.touch()
    subject = WireRecording([Connection("slcan", str(line), 0.0, None, [Record(1.0, True, b"C\r")])], [])

    async def whole() -> None:
        with pytest.raises(CellError, match="unplug it, or give the player a folder"):
            async with WirePlayer(subject, MonotonicClock()):
                raise AssertionError("it is played")

    asyncio.run(whole())
    assert line.is_symlink() if dangling else line.exists()


def test_frames_of_a_modbus_line_end_where_its_specification_says() -> None:
    """Lengths of MODBUS Application Protocol 1.1b3, chapter 6, with unit and check sum."""
    for length, frame in (
        (rtu_request, "010400300001cccc"),
        (rtu_request, "011000010002040000ffffcccc"),
        (rtu_request, "012b0e0480cccc"),
        (rtu_reply, "01040400010002cccc"),
        (rtu_reply, "018402cccc"),
        (rtu_reply, "011000010002cccc"),
        (rtu_reply, "012b0e01010000020003616263010161cccc"),
    ):
        data = bytes.fromhex(frame)
        assert [length(data[:n]) for n in range(len(data) + 1)][-1] == len(data), frame
        assert length(data + b"\x01\x04") == len(data), frame
        assert all(length(data[:n]) in (None, len(data)) for n in range(len(data))), frame
