"""Input modules made of servers that are not ours, and the driver opened on them."""

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from pymodbus import ModbusDeviceIdentification
from pymodbus.constants import ExcCodes
from pymodbus.pdu.device import ModbusControlBlock
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from cell.clock import MonotonicClock
from cell.devices import InputsState
from cell.samples import Sample
from drivers.modbus_inputs import InputsConfig, ModbusInputs

HOST = "127.0.21.1"
INPUTS: dict[str, Any] = {"xs": {"address": 0}, "ys": {"address": 1}}
COILS, DISCRETE, HOLDING, INPUT = 1, 2, 3, 4


@dataclass
class Board:
    """A module as its manual draws it: registers and bits by table, made anew for every request."""

    make: str = "ioLogik-E1210"
    levels: list[bool] = field(default_factory=lambda: [False, False])
    counts: list[int] = field(default_factory=lambda: [0, 0])
    delay_s: float = 0.0
    refusal: ExcCodes | None = None
    mute: bool = False
    asked: list[tuple[float, int, int, int]] = field(default_factory=list)  # when, function, address, count
    look: Callable[["Board"], None] = lambda board: None
    uptime: int = 1000
    end: asyncio.Event = field(default_factory=asyncio.Event)
    working: set["asyncio.Task[Any]"] = field(default_factory=set)

    def tables(self) -> dict[int, dict[int, int]]:
        """Words or bits by function code and address, written down from the manuals."""
        high_low = [half for n in self.counts for half in divmod(n % 2**32, 65536)]
        low_high = [half for n in self.counts for half in reversed(divmod(n % 2**32, 65536))]
        word = sum(level << k for k, level in enumerate(self.levels))
        bits = dict(enumerate(self.levels))
        return {
            "ioLogik-E1210": {DISCRETE: bits, INPUT: {**dict(enumerate(high_low, 0x10)), 0x30: word}},
            "ADAM-6050": {COILS: bits, HOLDING: dict(enumerate(low_high))},
            "WAGO-750": {DISCRETE: bits},
            "generic": {
                DISCRETE: bits,
                HOLDING: {5: word, **dict(enumerate((n % 65536 for n in self.counts), 6))},
                INPUT: {
                    **dict(enumerate(low_high, 40)),
                    60: self.uptime,
                    61: 0x4142,
                    62: 0x3132,
                    63: 0x3300,
                },
            },
        }[self.make]

    async def action(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: Any
    ) -> ExcCodes | None:
        """What pymodbus calls before each reply."""
        task = asyncio.current_task()
        assert task is not None
        self.working.add(task)
        task.add_done_callback(self.working.discard)
        if self.delay_s:
            await asyncio.sleep(self.delay_s)
        self.asked.append((time.monotonic(), function, address, count))
        if self.mute:
            await self.end.wait()
        self.look(self)
        if self.refusal is not None:
            return self.refusal
        for at, value in self.tables().get(function, {}).items():
            if function in (COILS, DISCRETE):
                kept = registers[at // 16] & ~(1 << at % 16)
                registers[at // 16] = kept | (int(value) << at % 16)
            else:
                registers[at - start] = value
        return None

    async def finish(self) -> None:
        """Let requests in the works end, as a server leaves them behind."""
        self.end.set()
        if self.working:
            await asyncio.wait(self.working)

    def device(self) -> SimDevice:
        """Catch-all unit of a pymodbus server with four tables of 64 places."""
        bits = [SimData(0, values=[False] * 64, datatype=DataType.BITS)]
        words = [SimData(0, count=64, datatype=DataType.REGISTERS)]
        return SimDevice(0, (bits, bits, words, words), action=self.action)


@asynccontextmanager
async def pymodbus_server(
    board: Board,
    identity: dict[str, str] | None = None,
    connections: list[bool] | None = None,
) -> AsyncIterator[str]:
    """The url of ``board`` behind pymodbus' own TCP server; ``connections`` gets its comings and goings."""
    with_identity(identity or {})
    server = ModbusTcpServer(
        board.device(),
        address=(HOST, 0),
        trace_connect=None if connections is None else connections.append,
    )
    await server.serve_forever(background=True)
    host, port = server.transport.sockets[0].getsockname()
    try:
        yield f"tcp://{host}:{port}"
    finally:
        await board.finish()
        await server.shutdown()
        for _ in range(3):  # a request that came meanwhile is taken up two turns of the loop later
            await asyncio.sleep(0)
        await board.finish()


def with_identity(identity: dict[str, str]) -> None:
    """pymodbus keeps one identity for all servers of a process."""
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    told = ModbusDeviceIdentification(
        info_name={"VendorName": "", "ProductCode": "", "MajorMinorRevision": "", **identity}
    )
    ModbusControlBlock().Identity.update(told)


def make(url: str, **keys: Any) -> ModbusInputs:
    """The driver, not yet open."""
    return ModbusInputs("beams", InputsConfig(**{"url": url, "inputs": INPUTS, **keys}), MonotonicClock())


@asynccontextmanager
async def opened(url: str, **keys: Any) -> AsyncIterator[ModbusInputs]:
    """The driver, open."""
    device = make(url, **keys)
    await device.open()
    try:
        yield device
    finally:
        await device.close()


async def newest(device: ModbusInputs) -> Sample[InputsState]:
    """A poll that was made after the call."""
    await device.wait_fresh(2.0)
    return device.inputs.latest(1.0)
