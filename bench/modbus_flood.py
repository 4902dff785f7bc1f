"""A PLC beside floods of the Modbus server: its polls, the loop's lag, memory and log.

Each row takes ``SECONDS`` (or the first argument), with the same face in a process of its own and the
attackers in another: strangers that poll and reconnect, and malformed requests with refused writes. Quiet
rows stand before and after, for what else the machine does.
"""

import asyncio
import logging
import multiprocessing
import random
import struct
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil
from pyModbusTCP.client import ModbusClient

from cell.clock import MonotonicClock
from cell.store.ledger import Ledger
from daemon.config import ModbusSection
from daemon.health import Beats, LoopLag
from daemon.modbus import Command, ModbusFace

SECONDS = 60.0
HOST, STRANGER = "127.0.0.1", "127.0.0.9"
STRANGERS, MALFORMED_A_SECOND, FLOODERS = 40, 1000, 4
POLL = bytes.fromhex("000100000006010400000040")
HEARTBEAT = 10
GOAL_LAG_S = 0.020


def main(seconds: float) -> int:
    print(f"{'':34}{'polls':>7}{'lost':>6}{'p99':>8}{'max':>8}{'lag p99':>9}{'max':>8}", end="")
    print(f"{'HB lost':>8}{'MiB':>7}{'log':>9}{'audit':>7}   ms, lines")
    fit = [
        row(name, strangers, malformed, seconds)
        for name, strangers, malformed in (
            ("nothing else", 0, 0),
            (f"{STRANGERS} strangers", STRANGERS, 0),
            (f"{MALFORMED_A_SECOND} malformed requests/s", 0, MALFORMED_A_SECOND),
            ("both", STRANGERS, MALFORMED_A_SECOND),
            ("nothing else, again", 0, 0),
        )
    ]
    return 0 if all(fit) else 1


def row(name: str, strangers: int, malformed: int, seconds: float) -> bool:
    """One line of the table; False when the PLC was lost or the loop was later than the goal."""
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="cellward-bench-") as folder:
        ours, theirs = spawn.Pipe()
        server = spawn.Process(target=serve, args=(theirs, folder))
        server.start()
        port = ours.recv()
        attack = spawn.Process(target=attackers, args=(port, strangers, malformed), daemon=True)
        attack.start()
        times, lost = poll_as_plc(port, seconds)
        memory = psutil.Process(server.pid).memory_info().rss / 2**20
        attack.terminate()
        attack.join()
        ours.send("end")
        facts = ours.recv()
        server.join()
    times.sort()
    lag = facts["lag"]
    print(f"{name:34}{len(times):7}{lost:6}", end="")
    print(f"{1e3 * times[len(times) * 99 // 100]:8.1f}{1e3 * times[-1]:8.1f}", end="")
    print(f"{1e3 * lag['p99_s']:9.1f}{1e3 * lag['max_s']:8.1f}{facts['heartbeats_lost']:8}", end="")
    print(f"{memory:7.0f}{facts['log_lines']:9}{facts['audit_lines']:7}", flush=True)
    return not lost and not facts["heartbeats_lost"] and lag["p99_s"] <= GOAL_LAG_S


def poll_as_plc(port: int, seconds: float) -> tuple[list[float], int]:
    """Beat and poll at 10 Hz with an independent client; the round trips (s) and how many failed."""
    client = ModbusClient(HOST, port, timeout=1.0, auto_open=True)
    times, lost = [], 0
    for beat in range(int(seconds * 10)):
        begun = time.monotonic()
        done = client.write_single_register(HEARTBEAT, beat % 65536 + 1 & 0xFFFF)
        if done and client.read_input_registers(0, 64):
            times.append(time.monotonic() - begun)
        else:
            lost += 1
        time.sleep(max(0.0, begun + 0.1 - time.monotonic()))
    client.close()
    return times or [float("nan")], lost


def serve(pipe: Connection, folder: str) -> None:
    """The face with its ledger in this process, until the pipe says end."""
    asyncio.run(_serve(pipe, Path(folder)))


async def _serve(pipe: Connection, folder: Path) -> None:
    log = folder / "log"
    logging.basicConfig(filename=log, level=logging.INFO)
    ledger, clock = Ledger(folder / "ledger.sqlite"), MonotonicClock()
    lost: list[bool] = []

    async def accept(command: Command) -> int:
        return 1

    def snapshot() -> dict[str, Any]:
        return {"status": 1}

    section = {"bind": f"{HOST}:0", "allow_write": True, "allow_clients": [HOST]}
    face = ModbusFace(
        ModbusSection.model_validate(section),
        clock,
        accept,
        snapshot,
        audit=lambda *line: ledger.audit("modbus", *line),
        on_plc=lambda alive: None if alive else lost.append(True),
    )
    lag = LoopLag(clock)
    watch = asyncio.create_task(lag.watch(Beats(clock), 0.05))
    await face.start()
    pipe.send(face.address[1])
    await asyncio.to_thread(pipe.recv)
    watch.cancel()
    heartbeats_lost = len(lost)
    await face.stop()
    pipe.send(
        {
            "lag": lag.summary(),
            "heartbeats_lost": heartbeats_lost,
            "log_lines": len(log.read_text().splitlines()),
            "audit_lines": len(ledger.audit_lines(10**9)),
        }
    )
    ledger.close()


def attackers(port: int, strangers: int, malformed: int) -> None:
    """All attackers, from an address that is not listed."""
    asyncio.run(_attack(port, strangers, malformed))


async def _attack(port: int, strangers: int, malformed: int) -> None:
    tasks = [_pester(port) for _ in range(strangers)]
    tasks += [_flood(port, malformed / FLOODERS, seed) for seed in range(FLOODERS if malformed else 0)]
    await asyncio.gather(*tasks)


async def _pester(port: int) -> None:
    while True:
        with suppress(OSError, asyncio.IncompleteReadError):
            reader, writer = await asyncio.open_connection(HOST, port, local_addr=(STRANGER, 0))
            try:
                while True:
                    writer.write(POLL)
                    await reader.readexactly(9 + 128)
                    await asyncio.sleep(0.05)
            finally:
                writer.transport.abort()
        await asyncio.sleep(0.05)


async def _flood(port: int, a_second: float, seed: int) -> None:
    """Requests of random functions and data, refused writes among them; reconnects when closed."""
    chance = random.Random(seed)
    due = time.monotonic()
    while True:
        with suppress(OSError):
            _, writer = await asyncio.open_connection(HOST, port, local_addr=(STRANGER, 0))
            writer.transport.set_write_buffer_limits(1 << 16)
            while not writer.transport.is_closing():
                body = bytes([chance.choice((6, 16, 4, 99, 200))]) + chance.randbytes(chance.randrange(8))
                protocol = 0 if chance.random() < 0.999 else 7
                writer.write(struct.pack(">HHHB", 1, protocol, len(body) + 1, 1) + body)
                await writer.drain()
                due += 1.0 / a_second
                await asyncio.sleep(max(0.0, due - time.monotonic()))
        due = time.monotonic()
        await asyncio.sleep(0.02)


def _seconds(arguments: Sequence[str]) -> float:
    return float(arguments[0]) if arguments else SECONDS


if __name__ == "__main__":
    sys.exit(main(_seconds(sys.argv[1:])))
