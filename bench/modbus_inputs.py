"""How evenly the input driver polls, how fast its answers come and what it costs, beside a bare client.

A fake ioLogik E1210 on loopback in a process of its own, which answers at once. Rows of the same period run
at the same time, each in its own process: our driver (timerfd, edge counters, samples), and a bare pymodbus
loop on ``asyncio.sleep`` that does nothing with its replies. Periods are between the starts of requests;
gaps are polls that the time would have allowed and that were not made.
"""

import asyncio
import logging
import multiprocessing
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from pymodbus.client import AsyncModbusTcpClient

from cell.clock import MonotonicClock
from drivers.modbus_inputs import InputsConfig, ModbusInputs
from fakes.modbus_io import Identity, Module, ModuleWires, Pace, TcpPlace, register_map

HOST = "127.0.21.3"
MODULE = "ioLogik-E1210"
PERIODS_S = (0.002, 0.005, 0.010)
SECONDS = 5.0
WARM_UP_S = 0.3


class Blinking:
    """Two inputs, 13 changes a second."""

    def levels(self, t: float) -> tuple[bool, ...]:
        return bool(int(13 * t) % 2), not int(13 * t) % 2

    def counts(self, t: float) -> tuple[int, ...]:
        return (int(13 * t) + 1) // 2, int(13 * t) // 2

    def reboot(self, t: float) -> None:
        """Nothing is kept."""


def main() -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=serve, args=(theirs,), daemon=True)
    server.start()
    port = ours.recv()
    print(f"{MODULE} on loopback, {SECONDS:.0f} s each, driver and bare client at the same time")
    print(
        f"{'period':>8}{'':>8}{'polls':>7}{'gaps':>6}{'p50':>8}{'p99':>8}{'max':>8}"
        f"{'reply p50':>11}{'p99':>7}{'CPU %':>7}   (ms)"
    )
    try:
        for period in PERIODS_S:
            rows = []
            for name, work in (("driver", drive), ("bare", bare)):
                here, there = context.Pipe()
                process = context.Process(target=work, args=(port, period, there), daemon=True)
                process.start()
                rows.append((name, here, process))
            for name, here, process in rows:
                show(period, name, *here.recv())
                process.join()
    finally:
        ours.send("end")
        server.join()


def show(period: float, name: str, begins: Any, trips: Any, cpu_s: float, gaps: int) -> None:
    steps, trips = 1000.0 * np.diff(begins), 1000.0 * np.asarray(trips)
    print(
        f"{1000 * period:8.1f}{name:>8}{len(begins):7d}{gaps:6d}{np.percentile(steps, 50):8.2f}"
        f"{np.percentile(steps, 99):8.2f}{steps.max():8.2f}{np.percentile(trips, 50):11.2f}"
        f"{np.percentile(trips, 99):7.2f}{100.0 * cpu_s / SECONDS:7.1f}"
    )


def drive(port: int, period: float, pipe: Connection) -> None:
    """Our driver."""

    async def run() -> None:
        config = InputsConfig.model_validate(
            {
                "url": f"tcp://{HOST}:{port}",
                "module": MODULE,
                "poll_period_s": period,
                "inputs": {"xs": {"address": 0}, "ys": {"address": 1}},
            }
        )
        device = ModbusInputs("beams", config, MonotonicClock())
        await device.open()
        await asyncio.sleep(WARM_UP_S)
        polls: list[Any] = []
        gaps, cpu = device.inputs.gaps, time.process_time()
        device.inputs.subscribe(polls.append)
        await asyncio.sleep(SECONDS)
        cpu, gaps = time.process_time() - cpu, device.inputs.gaps - gaps
        await device.close()
        pipe.send(([p.t - p.dt for p in polls], [2.0 * p.dt for p in polls], cpu, gaps))

    asyncio.run(run())


def bare(port: int, period: float, pipe: Connection) -> None:
    """A loop as one writes it first."""

    async def run() -> None:
        client = AsyncModbusTcpClient(HOST, port=port, timeout=0.05, retries=0)
        await client.connect()
        await asyncio.sleep(WARM_UP_S)
        begins, trips = [], []
        cpu, end = time.process_time(), time.monotonic() + SECONDS
        following = time.monotonic()
        while (begin := time.monotonic()) < end:
            await client.read_input_registers(0x10, count=33)
            begins.append(begin)
            trips.append(time.monotonic() - begin)
            following = max(following + period, time.monotonic())
            await asyncio.sleep(following - time.monotonic())
        cpu = time.process_time() - cpu
        client.close()
        missed = round((begins[-1] - begins[0]) / period) + 1 - len(begins)
        pipe.send((begins, trips, cpu, max(missed, 0)))

    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    asyncio.run(run())


def serve(pipe: Connection) -> None:
    """The module, until told to end."""

    async def run() -> None:
        module = Module(Blinking(), register_map(MODULE), Identity(MODULE), time.monotonic)
        wires = ModuleWires(module, (TcpPlace(HOST, 0),), pace=Pace(0.0, 0.0))
        await wires.start()
        pipe.send(wires.addresses[0][1])
        await asyncio.to_thread(pipe.recv)
        await wires.stop()

    asyncio.run(run())


if __name__ == "__main__":
    main()
