"""A minute of positions every millisecond through a serial CAN adapter: none may be missing."""

import asyncio
import multiprocessing
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from cell.clock import MonotonicClock
from drivers.can_encoder import CanopenEncoder, CanopenEncoderConfig
from fakes.can import CanWires
from fakes.can.bus import Frame
from fakes.wire.lifetime import run_as_controller
from tests.kit.can_rig import NODE, SERIAL, TestShaft

pytestmark = [pytest.mark.soak, pytest.mark.wire]
SECONDS = 60.0


def serve(line: str, pipe: Connection) -> None:
    """The encoder and its adapter, in a process of their own; tells at the end what was sent."""

    run_as_controller()

    async def run() -> None:
        wires = CanWires(TestShaft(), NODE, SERIAL, time.monotonic, Path(line))
        sent: list[int] = []

        def record(frame: Frame, t: float) -> None:
            if frame.id == wires.node.position_id:
                sent.append(int.from_bytes(frame.data, "little"))

        wires.bus.join(record)
        await wires.start()
        pipe.send(wires.buses["slcan"])
        await asyncio.to_thread(pipe.recv)
        wires.node.silent = True
        pipe.send(sent)
        await asyncio.to_thread(pipe.recv)
        await wires.stop()

    asyncio.run(run())


async def count(bus: str, pipe: Connection) -> tuple[list[int], list[int], CanopenEncoder]:
    """Positions that were sent, those that the driver has taken within a minute, and the driver."""
    taken: list[int] = []
    config = CanopenEncoderConfig(bus=bus, node=NODE, period_s=0.001, lost_after_s=2.0)
    device = CanopenEncoder("belt", config, MonotonicClock())
    device.counts.subscribe(lambda sample: taken.append(sample.value.raw))
    await device.open()
    try:
        await asyncio.sleep(SECONDS)
        pipe.send("silent")
        sent = await asyncio.to_thread(pipe.recv)
        await asyncio.sleep(0.2)
        return sent, taken, device
    finally:
        await device.close()


def test_a_minute_of_frames_every_millisecond_loses_none(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=serve, args=(str(tmp_path / "can.tty"), theirs), daemon=True)
    server.start()
    try:
        sent, taken, device = asyncio.run(count(ours.recv(), ours))
    finally:
        ours.send("end")
        server.join()
        ours.close()
        theirs.close()
    print(f"sent {len(sent)}, taken {len(taken)}, gaps told {device.counts.gaps}")
    assert len(taken) > 0.95 * 1000 * SECONDS
    assert taken == sent[-len(taken) :], "all but those that were on their way when counting began"
    assert device.health()["malformed"] == 0
