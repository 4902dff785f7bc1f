"""A Modbus face with a plant behind it, and a raw client: for the tests of the face."""

import asyncio
import struct
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

import pytest

from cell.clock import MonotonicClock
from daemon.config import ModbusSection
from daemon.modbus import Command, ModbusFace

HOST = "127.0.0.40"


@dataclass
class Plant:
    """The daemon behind the face: records commands, answers with ``answer``."""

    answer: int = 1
    status: int = 1
    delay_s: float = 0.0
    commands: list[Command] = field(default_factory=list)
    audit: list[tuple[str, str, bool, str]] = field(default_factory=list)
    remembered: list[int] = field(default_factory=list)
    plc: list[bool] = field(default_factory=list)
    finished: list[int] = field(default_factory=list)
    faulty: bool = False

    async def handle(self, command: Command) -> int:
        self.commands.append(command)
        if self.delay_s and command.code not in (3, 4):
            await asyncio.sleep(self.delay_s)
        if self.faulty:
            raise RuntimeError("a defect")
        self.finished.append(command.code)
        return self.answer

    def snapshot(self) -> dict[str, Any]:
        return {"status": self.status, "run_id": 0x00010002, "belt_speed_m_s": 0.25, "packml_state": 4}


def face_of(plant: Plant, clock: Any = None, last_sequence: int = 0, **keys: Any) -> ModbusFace:
    section = {"bind": f"{HOST}:0", "allow_write": True, "allow_clients": ["127.0.0.0/8"], **keys}
    return ModbusFace(
        ModbusSection.model_validate(section),
        clock or MonotonicClock(),
        plant.handle,
        plant.snapshot,
        audit=lambda *line: plant.audit.append(line),
        on_plc=plant.plc.append,
        last_sequence=last_sequence,
        remember=plant.remembered.append,
    )


class Client:
    """A raw Modbus client: frames by hand, so that the server is not judged by a library's habits."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.transaction = 0

    def frame(self, pdu: str, unit: int = 1) -> bytes:
        self.transaction += 1
        body = bytes.fromhex(pdu)
        return struct.pack(">HHHB", self.transaction, 0, len(body) + 1, unit) + body

    async def reply(self) -> tuple[int, int, bytes]:
        async with asyncio.timeout(5.0):
            transaction, _, length, unit = struct.unpack(">HHHB", await self.reader.readexactly(7))
            return transaction, unit, await self.reader.readexactly(length - 1)

    async def ask(self, pdu: str, unit: int = 1) -> str:
        self.writer.write(self.frame(pdu, unit))
        return (await self.reply())[2].hex()

    async def words(self, address: int, count: int) -> list[int]:
        reply = bytes.fromhex(await self.ask(f"04{address:04x}{count:04x}"))
        assert reply[0] == 4, reply.hex()
        return list(struct.unpack(f">{count}H", reply[2:]))

    async def write(self, address: int, *values: int) -> str:
        data = "".join(f"{value:04x}" for value in values)
        return await self.ask(f"10{address:04x}{len(values):04x}{2 * len(values):02x}{data}")

    async def acknowledged(self, sequence: int) -> int:
        """The result code once ``sequence`` is acknowledged."""
        async with asyncio.timeout(5.0):
            while True:
                words = await self.words(1, 2)
                if words[0] == sequence:
                    return words[1]
                await asyncio.sleep(0.005)

    async def ended(self) -> bool:
        async with asyncio.timeout(5.0):
            try:
                return await self.reader.read(1) == b""
            except ConnectionError:
                return True

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            return


async def connect(face: ModbusFace, source: str = HOST) -> Client:
    return Client(*await asyncio.open_connection(*face.address, local_addr=(source, 0)))


def talk(subject: ModbusFace, script: Callable[[Client], Awaitable[None]], source: str = HOST) -> None:
    """Start the face, run ``script`` with one client, stop the face."""

    async def scene() -> None:
        await subject.start()
        try:
            client = await connect(subject, source)
            try:
                await script(client)
            finally:
                await client.close()
        finally:
            await subject.stop()

    run(scene())


def run(scene: Coroutine[Any, Any, None]) -> None:
    asyncio.run(scene)


@pytest.fixture
def plant() -> Plant:
    return Plant()


@pytest.fixture
def subject(plant: Plant) -> ModbusFace:
    return face_of(plant)
