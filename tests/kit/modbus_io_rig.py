"""A fake input module with inputs that are functions of time, and a client that writes its frames by hand."""

import asyncio
import socket
import struct
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from math import floor
from pathlib import Path
from ssl import SSLContext

from fakes.faults.vocabulary import Switchboard
from fakes.modbus_io import Identity, Module, ModuleFaults, ModuleWires, Pace, TcpPlace, register_map

HOST = "127.0.22.1"
AT_ONCE = Pace(0.0, 0.0)


@dataclass
class Pulses:
    """Input 0 is on for ``width`` s in every ``period`` s, input 1 is its opposite; counts rising edges."""

    period: float = 0.037
    width: float = 0.004
    start: float = field(default_factory=time.monotonic)

    def levels(self, t: float) -> tuple[bool, ...]:
        on = (t - self.start) % self.period < self.width
        return on, not on

    def counts(self, t: float) -> tuple[int, ...]:
        turns = (t - self.start) / self.period
        return floor(turns) + 1, floor(turns - self.width / self.period) + 1

    def reboot(self, t: float) -> None:
        self.start = t


@dataclass
class Steady:
    """Levels that stay, counts that are known."""

    count: tuple[int, ...] = (70000, 3, 5)

    def levels(self, t: float) -> tuple[bool, ...]:
        return True, False, True

    def counts(self, t: float) -> tuple[int, ...]:
        return self.count

    def reboot(self, t: float) -> None:
        self.count = (0, 0, 0)


@dataclass
class Rig:
    """A module that listens, with its switchboard."""

    wires: ModuleWires
    faults: ModuleFaults
    switchboard: Switchboard

    @property
    def address(self) -> tuple[str, int]:
        return self.wires.addresses[0]

    def inject(self, name: str, **arguments: object) -> None:
        self.switchboard.inject("beams", name, arguments)


@asynccontextmanager
async def rig(
    make: str = "generic",
    inputs: Pulses | Steady | None = None,
    pace: Pace = AT_ONCE,
    line: Path | None = None,
    tls: SSLContext | None = None,
) -> AsyncIterator[Rig]:
    """A module on a free port of ``HOST``."""
    module = Module(inputs or Steady(), register_map(make), Identity(make), time.monotonic)
    wires = ModuleWires(module, (TcpPlace(HOST, 0, tls),), line, pace)
    faults, switchboard = ModuleFaults(wires), Switchboard()
    switchboard.devices["beams"] = faults
    await wires.start()
    try:
        yield Rig(wires, faults, switchboard)
    finally:
        faults.close()
        await wires.stop()
        await asyncio.sleep(0)


def mbap(transaction: int, pdu: str, unit: int = 1) -> bytes:
    body = bytes.fromhex(pdu)
    return struct.pack(">HHHB", transaction, 0, len(body) + 1, unit) + body


class RawClient:
    """Frames by hand, so that the server is not judged by a library's habits."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.transaction = 0

    @classmethod
    async def open(cls, address: tuple[str, int]) -> "RawClient":
        # From another address than HOST: a free port there may be the one where the module listens again.
        return cls(*await asyncio.open_connection(*address))

    def put(self, pdu: str, unit: int = 1) -> None:
        self.transaction += 1
        self.writer.write(mbap(self.transaction, pdu, unit))

    async def reply(self, timeout: float = 5.0) -> tuple[int, int, str]:
        """Transaction, unit and PDU of the next frame."""
        async with asyncio.timeout(timeout):
            head = await self.reader.readexactly(7)
            transaction, protocol, length, unit = struct.unpack(">HHHB", head)
            assert protocol == 0
            return transaction, unit, (await self.reader.readexactly(length - 1)).hex()

    async def ask(self, pdu: str, timeout: float = 5.0) -> str:
        self.put(pdu)
        return (await self.reply(timeout))[2]

    async def silent(self, seconds: float = 0.05) -> bool:
        """Whether nothing comes for a while, on a connection that stays open."""
        try:
            async with asyncio.timeout(seconds):
                await self.reader.readexactly(1)
        except TimeoutError:
            return True
        return False

    async def ended(self) -> str:
        """How the connection ended: ``FIN`` or ``RST``."""
        async with asyncio.timeout(5.0):
            try:
                while await self.reader.read(4096):
                    pass
            except ConnectionResetError:
                return "RST"
        return "FIN"

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            return

    async def __aenter__(self) -> "RawClient":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


def deaf_socket(address: tuple[str, int]) -> socket.socket:
    """A client that never reads, with a small window."""
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.connect(address)
    deaf.setblocking(False)
    return deaf
