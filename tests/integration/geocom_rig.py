"""A little total station for tests, on TCP or a pseudo-terminal. Its lines are put together here, by hand."""

import asyncio
import os
import re
import tty
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from geocompy.communication import crc16_bytewise

from cell.clock import MonotonicClock
from drivers.tracker import GeocomConfig, GeocomTracker

HOST = "127.0.41.1"
SERIAL = "99994400001"
REFLECTORS: dict[str, Any] = {"smr1": {"constant_m": 0.0}, "big": {"constant_m": -0.0344}}
QUICK: dict[str, Any] = {
    "reflectors": REFLECTORS,
    "poll_period_s": 0.02,
    "timeout_s": 1.0,
    "distance_timeout_s": 0.5,
    "motion_timeout_s": 2.0,
}
_REQUEST = re.compile(rb"%R1Q,(\d+),(\d+)(?:,(\d+))?:(.*)", re.DOTALL)

Answer = Callable[[list[str]], str]


@dataclass
class Instrument:
    """``answers`` maps a procedure to what follows the colon of its reply; ``damage`` may spoil a reply."""

    hz: float = 0.3
    v: float = 1.4
    slope: float = 3.0
    step_m: float = 0.0  # each distance is longer by so much
    rc: int = 0  # of distances
    present: bool = True
    prism: float = 0.0
    locked: bool = False
    measuring: bool = False
    answers: dict[int, Answer] = field(default_factory=dict)
    asked: list[tuple[int, list[str]]] = field(default_factory=list)
    raw: bytearray = field(default_factory=bytearray)
    damage: Callable[[int, bytes], list[bytes] | None] = lambda rpc, reply: None
    delay_s: dict[int, float] = field(default_factory=dict)
    aborts: int = 0
    atr = 0
    lock_wanted = 0
    count = 0
    air: tuple[str, ...] = ("0.000000658", "1013.25", "21.5", "15.0")

    def answer(self, rpc: int, p: list[str]) -> str:
        """Return code and values for one procedure."""
        if rpc in self.answers:
            return self.answers[rpc](p)
        table: dict[int, Callable[[], str]] = {
            0: lambda: "0",
            107: lambda: "0",
            108: lambda: "0,15",
            110: lambda: "0,3,1,20",
            2008: lambda: self._do_measure(p[0]),
            2009: lambda: "0,100.0,200.0,10.0,1.5",
            2011: lambda: "0,0.1",
            2023: lambda: f"0,{self.prism}",
            2024: lambda: self._set("prism", float(p[0])),
            2028: lambda: self._set("air", tuple(p)),
            2029: lambda: "0," + ",".join(self.air),
            2107: lambda: f"0,{self.hz},{self.v}",
            2167: lambda: self._full(),
            2108: lambda: self._full("hz,v,slope"),
            5003: lambda: f"0,{SERIAL}",
            5004: lambda: '0,"TS60 test"',
            5034: lambda: "0,8,10,2",
            6021: lambda: f"0,{int(self.locked and self.present)}",
            9013: lambda: self._set("locked", True) if self.present else "8710",
            9018: lambda: self._set("atr", p[0]),
            9019: lambda: f"0,{self.atr}",
            9020: lambda: self._set("lock_wanted", p[0]),
            9021: lambda: f"0,{self.lock_wanted}",
            9027: lambda: "0",
            9037: lambda: "0" if self.present else "8710",
        }
        return table[rpc]() if rpc in table else "5"

    def sees(self, line: bytes) -> tuple[int, bytes] | None:
        """The reply to one line, and the procedure that it is from."""
        if line.strip() == b"c":
            self.aborts += 1
            return -1, b"?\r\n"
        match = _REQUEST.fullmatch(line.strip())
        if match is None:
            return (-2, b"%R1P,3078,0:0\r\n") if line.strip() else None
        rpc, number, crc, parameters = match.groups()
        if crc is not None:
            bare = b"%R1Q," + rpc + b"," + number + b":" + parameters
            assert crc16_bytewise(bare) == int(crc)
        values = parameters.decode().split(",")
        self.asked.append((int(rpc), values))
        result = self.answer(int(rpc), values)
        head, bare_reply = f"%R1P,0,{number.decode()}", f"%R1P,0,{number.decode()}:{result}"
        summed = f",{crc16_bytewise(bare_reply)}" if crc is not None else ""
        return int(rpc), f"{head}{summed}:{result}\r\n".encode()

    def told(self, rpc: int) -> list[list[str]]:
        """Parameters of every call of ``rpc`` so far."""
        return [p for r, p in self.asked if r == rpc]

    def _set(self, key: str, value: Any) -> str:
        setattr(self, key, value)
        return "0"

    def _do_measure(self, program: str) -> str:
        self.measuring = program in ("1", "2", "8")
        return "0"

    def _full(self, what: str = "full") -> str:
        if not self.measuring or not self.present:
            return "1285,0.3,1.4,0.0" + (",0,0,0,0,0" if what == "full" else "")
        self.count += 1
        self.slope += self.step_m
        if what != "full":
            return f"{self.rc},{self.hz},{self.v},{self.slope!r}"
        return f"{self.rc},{self.hz},{self.v},0.000005,0,0,0.000005,{self.slope!r},{1000 + self.count}"


Writer = Callable[[bytes], None]


async def _play(instrument: Instrument, line: bytes, write: Writer) -> None:
    instrument.raw += line
    if (seen := instrument.sees(line)) is None:
        return
    rpc, reply = seen
    await asyncio.sleep(instrument.delay_s.get(rpc, 0.0))
    damaged = instrument.damage(rpc, reply)
    for part in [reply] if damaged is None else damaged:
        write(part)
        await asyncio.sleep(0)


@asynccontextmanager
async def on_tcp(instrument: Instrument) -> AsyncIterator[tuple[str, list[asyncio.StreamWriter]]]:
    """The url of the instrument, and the connections that it has."""
    peers: list[asyncio.StreamWriter] = []
    tasks: set[asyncio.Task[None]] = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peers.append(writer)
        try:
            while line := await reader.readline():
                task = asyncio.create_task(_play(instrument, line, writer.write))
                tasks.add(task)
                task.add_done_callback(tasks.discard)
        except ConnectionError:
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(serve, HOST, 0)
    port = server.sockets[0].getsockname()[1]
    try:
        yield f"tcp://{HOST}:{port}", peers
    finally:
        server.close()
        for writer in peers:
            writer.transport.abort()
        for task in tasks:
            task.cancel()
        await asyncio.sleep(0.02)


@asynccontextmanager
async def on_pty(instrument: Instrument) -> AsyncIterator[tuple[str, Callable[[], Awaitable[None]]]]:
    """The url of the instrument behind a pseudo-terminal, and what pulls its plug."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    loop, rest, tasks = asyncio.get_running_loop(), bytearray(), set()

    def write(data: bytes) -> None:
        os.write(ours, data)

    def readable() -> None:
        try:
            rest.extend(os.read(ours, 4096))
        except OSError:
            return
        while b"\n" in rest:
            line, _, after = bytes(rest).partition(b"\n")
            rest[:] = after
            tasks.add(asyncio.create_task(_play(instrument, line + b"\n", write)))

    async def unplug() -> None:
        nonlocal ours
        if ours >= 0:
            loop.remove_reader(ours)
            os.close(ours)
            os.close(theirs)
            ours = -1

    loop.add_reader(ours, readable)
    try:
        yield f"serial://{os.ttyname(theirs)}?baudrate=115200", unplug
    finally:
        await unplug()
        for task in tasks:
            task.cancel()


def make(url: str, **keys: Any) -> GeocomTracker:
    """The driver, not yet open."""
    return GeocomTracker("tracker", GeocomConfig(**{"url": url, **QUICK, **keys}), MonotonicClock())


@asynccontextmanager
async def opened(url: str, **keys: Any) -> AsyncIterator[GeocomTracker]:
    """The driver, open."""
    device = make(url, **keys)
    await device.open()
    try:
        yield device
    finally:
        await device.close()
