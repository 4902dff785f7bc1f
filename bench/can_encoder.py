"""Frames that the encoder's driver takes, beside python-can's own Notifier with a callback that counts.

A twin of the adapter (slcan on a pseudo-terminal) and of the gateway (socketcand) in a process of its own
sends positions that are the microseconds of its clock, which both processes share: so the age of a frame
when a listener gets it, and how wrong its stamp is, can be read off each frame. Driver and Notifier run one
after the other, each in a fresh process; lost are frames that were sent between the first and the last that
arrived and did not. Age and stamp in ms; the stamp's error is that of the driver's sample, or of the
message's own time stamp turned monotonic. The gateway's stamps are perfect there, because it shares the wall
clock with the Notifier; the driver does not rely on that.
"""

import asyncio
import multiprocessing
import struct
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import can
import numpy as np

from cell.clock import MonotonicClock
from drivers.can_encoder import RawCanEncoder, RawCanEncoderConfig
from fakes.can import CanWires
from fakes.can.bus import Frame
from fakes.wire.lifetime import run_as_controller
from fakes.wire.listening import TcpPlace
from fakes.wire.ticker import Ticker

HOST = "127.0.51.9"
IDENTIFIER = 0x185
RATES_HZ = (200, 1000, 3000)
SECONDS = 5.0
WARM_UP_S = 0.5
RANGE = 1 << 32
Row = tuple[list[int], list[float], list[float], float]  # positions, arrivals, stamps, processor time


class Idle:
    """A shaft for the node, which stays silent."""

    modulus = RANGE

    def told(self, t: float) -> float:
        return t

    def raw(self, t: float) -> int:
        return 0

    def speed(self, t: float) -> float:
        return 0.0

    def preset(self, t: float, position: int) -> None: ...

    def restart(self, t: float) -> None: ...


def main() -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=serve, args=(theirs,), daemon=True)
    server.start()
    buses = ours.recv()
    print(f"positions of 4 bytes, {SECONDS:.0f} s each")
    print(
        f"{'':12}{'rate':>6}{'':>10}{'frames/s':>10}{'lost':>6}{'CPU %':>7}"
        f"{'age p50':>9}{'p99':>7}{'max':>7}{'stamp p50':>11}{'p99':>7}   (ms)"
    )
    try:
        for interface, bus in buses.items():
            for rate in RATES_HZ:
                for name, work in (("driver", drive), ("Notifier", notify)):
                    here, there = context.Pipe()
                    process = context.Process(target=work, args=(bus, rate, there), daemon=True)
                    process.start()
                    there.close()
                    here.recv()  # the bus is open: python-can's gateway bus cannot be on a busy one
                    ours.send(rate)
                    show(interface, rate, name, here.recv())
                    process.join()
                    ours.send(0)
    finally:
        ours.send(None)
        server.join()


def show(interface: str, rate: int, name: str, row: Row) -> None:
    positions, arrivals, stamps, cpu_s = row
    sent_at = np.array(positions) * 1e-6
    numbers = np.round((sent_at - sent_at[0]) * rate)
    lost = int(numbers[-1] + 1 - len(np.unique(numbers)))
    now = np.array(arrivals)
    age = 1000.0 * ((now - sent_at + 0.5 * RANGE * 1e-6) % (RANGE * 1e-6) - 0.5 * RANGE * 1e-6)
    off = 1000.0 * np.abs(
        (np.array(stamps) - sent_at + 0.5 * RANGE * 1e-6) % (RANGE * 1e-6) - 0.5 * RANGE * 1e-6
    )
    span = sent_at[-1] - sent_at[0]
    print(
        f"{interface:12}{rate:6d}{name:>10}"
        f"{(len(positions) - 1) / span:10.0f}{lost:6d}{100 * cpu_s / span:7.1f}"
        f"{np.percentile(age, 50):9.2f}{np.percentile(age, 99):7.2f}{age.max():7.2f}"
        f"{np.percentile(off, 50):11.2f}{np.percentile(off, 99):7.2f}"
    )


def drive(bus: str, rate: int, pipe: Connection) -> None:
    """Our driver."""

    async def run() -> None:
        config = RawCanEncoderConfig(
            bus=bus, id=IDENTIFIER, period_s=max(1.0 / rate, 0.001), lost_after_s=2.0
        )
        device = RawCanEncoder("belt", config, MonotonicClock())
        await device.open()
        pipe.send("open")
        await asyncio.sleep(WARM_UP_S)
        positions: list[int] = []
        arrivals: list[float] = []
        stamps: list[float] = []

        def take(sample: Any) -> None:
            positions.append(sample.value.raw)
            arrivals.append(time.monotonic())
            stamps.append(sample.t)

        undo = device.counts.subscribe(take)
        cpu = time.process_time()
        await asyncio.sleep(SECONDS)
        undo()
        pipe.send((positions, arrivals, stamps, time.process_time() - cpu))
        await device.close()

    asyncio.run(run())


def notify(bus: str, rate: int, pipe: Connection) -> None:
    """python-can as its documentation shows it."""
    positions: list[int] = []
    arrivals: list[float] = []
    stamps: list[float] = []

    def take(message: can.Message) -> None:
        if message.arbitration_id == IDENTIFIER:
            positions.append(struct.unpack("<I", message.data)[0])
            arrivals.append(time.monotonic())
            stamps.append(message.timestamp)

    opened = _opened(bus)
    notifier = can.Notifier(opened, [take], timeout=0.1)
    pipe.send("open")
    time.sleep(WARM_UP_S)
    for seen in (positions, arrivals, stamps):
        seen.clear()
    cpu = time.process_time()
    time.sleep(SECONDS)
    cpu = time.process_time() - cpu
    notifier.stop()
    opened.shutdown()
    offset = time.monotonic() - time.time()
    pipe.send((positions, arrivals, [stamp + offset for stamp in stamps], cpu))


def _opened(bus: str) -> can.BusABC:
    interface, _, rest = bus.partition(":")
    if interface == "slcan":
        path, _, bit_rate = rest.partition("@")
        return can.Bus(interface="slcan", channel=path, bitrate=int(bit_rate), sleep_after_open=0.0)
    address, _, channel = rest.partition("/")
    host, _, port = address.partition(":")
    return can.Bus(interface="socketcand", channel=channel, host=host, port=int(port))


def serve(pipe: Connection) -> None:
    """Adapter and gateway; what comes through the pipe is the rate of frames, None ends."""
    run_as_controller()

    async def run() -> None:
        with tempfile.TemporaryDirectory(prefix="can-") as folder:
            line, place = Path(folder) / "can.tty", TcpPlace(HOST, 0)
            wires = CanWires(Idle(), 5, 999966001, time.monotonic, line, place)
            await wires.start()
            port = wires.bus.join(lambda frame, t: None)

            def send(t: float) -> None:
                port.send(Frame(IDENTIFIER, struct.pack("<I", round(t * 1e6) % RANGE)), t)

            pipe.send(wires.buses)
            ticker: Ticker | None = None
            receive: Callable[[], Any] = pipe.recv
            while (rate := await asyncio.to_thread(receive)) is not None:
                if ticker is not None:
                    ticker.stop()
                    ticker = None
                if rate:
                    ticker = Ticker(rate, send, time.monotonic)
                    ticker.start()
            await wires.stop()

    asyncio.run(run())


if __name__ == "__main__":
    main()
