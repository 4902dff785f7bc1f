"""The two ways to a Robotiq gripper: Modbus, and the text socket of its URCap on the arm's controller."""

import asyncio
from typing import Protocol
from urllib.parse import urlsplit

from cell.answer_time import answer_within
from cell.errors import error
from cell.wire_recording.tap import NO_TAP, Tap, tap
from drivers.grippers.robotiq_words import (
    READ,
    REGISTERS,
    WRITTEN,
    Fingers,
    RobotiqState,
    activate_words,
    move_words,
)
from drivers.modbus.link import ModbusLink, NoAnswer
from drivers.modbus.registers import Span, Table

URCAP_PORT = 63352
_STATUS = Span(Table.INPUT, READ, REGISTERS)


class RobotiqLink(Protocol):
    """``NoAnswer`` when there is none in time; ``connect`` raises ``DEVICE_UNREACHABLE``."""

    async def connect(self) -> None: ...
    async def close(self) -> None: ...
    async def state(self) -> RobotiqState: ...
    async def activate(self, on: bool) -> None: ...
    async def move(self, position: int, speed: int, force: int) -> None: ...


class ModbusRobotiq:
    """By registers, on a serial line or a gateway."""

    def __init__(self, link: ModbusLink) -> None:
        self._link = link

    async def connect(self) -> None:
        await self._link.connect()

    async def close(self) -> None:
        await self._link.close()

    async def state(self) -> RobotiqState:
        return RobotiqState.from_registers(await self._link.read(_STATUS))

    async def activate(self, on: bool) -> None:
        await self._link.write(WRITTEN, activate_words(on))

    async def move(self, position: int, speed: int, force: int) -> None:
        await self._link.write(WRITTEN, move_words(position, speed, force))


class UrcapRobotiq:
    """Lines of text: ``GET POS`` is answered by ``POS 12``, ``SET POS 255 GTO 1`` by ``ack``.

    The URCap ends the connection, or says nothing, while the gripper is not connected to the controller.
    """

    def __init__(self, name: str, url: str, timeout_s: float, connect_timeout_s: float) -> None:
        parts = urlsplit(url)
        self._name, self._host, self._port = name, parts.hostname or "", parts.port or URCAP_PORT
        self._timeout_s, self._connect_timeout_s = timeout_s, connect_timeout_s
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._turn = asyncio.Lock()
        self._tap: Tap = NO_TAP

    async def connect(self) -> None:
        try:
            async with asyncio.timeout(self._connect_timeout_s):
                self._streams = await asyncio.open_connection(self._host, self._port, limit=1024)
        except (OSError, TimeoutError) as exc:
            raise error(
                "DEVICE_UNREACHABLE",
                f"{self._name} at {self._host}:{self._port}: {exc or 'no answer in time'};"
                " is the gripper's URCap installed, and the gripper connected to the controller?",
            ) from exc
        self._tap = tap("robotiq-urcap", f"{self._host}:{self._port}")

    async def close(self) -> None:
        streams, self._streams = self._streams, None
        if streams is not None:
            streams[1].transport.abort()
            self._tap.closed()
            await asyncio.sleep(0)  # an aborted transport closes its socket on the loop's next turn

    async def state(self) -> RobotiqState:
        return RobotiqState(
            await self._get("STA"),
            Fingers(await self._get("OBJ") & 3),
            await self._get("FLT") & 0x0F,
            await self._get("PRE"),
            await self._get("POS"),
        )

    async def activate(self, on: bool) -> None:
        await self._set("ACT 1" if on else "ACT 0")

    async def move(self, position: int, speed: int, force: int) -> None:
        await self._set(f"POS {position} SPE {speed} FOR {force} GTO 1")

    async def _get(self, name: str) -> int:
        answer = await self._say(f"GET {name}")
        parts = answer.split()
        if len(parts) != 2 or parts[0] != name or not parts[1].isdecimal():
            raise error("PROTOCOL_VIOLATION", f"{self._name} answered {answer[:40]!r} to 'GET {name}'")
        return int(parts[1])

    async def _set(self, values: str) -> None:
        answer = await self._say(f"SET {values}")
        if answer != "ack":
            raise error("PROTOCOL_VIOLATION", f"{self._name} answered {answer[:40]!r} to 'SET {values}'")

    async def _say(self, line: str) -> str:
        """The answer to a line. Without one the connection ends: a late one would answer the next line."""
        async with self._turn:
            if self._streams is None:
                raise NoAnswer("the connection is closed")
            reader, writer = self._streams
            data = line.encode("ascii") + b"\n"
            self._tap.sent(data)
            writer.write(data)
            try:
                async with answer_within(self._timeout_s):
                    answer = await self._answer(reader)
            except (OSError, TimeoutError) as exc:
                await self.close()
                raise NoAnswer(f"no answer to '{line}' in {self._timeout_s:g} s") from exc
            except asyncio.CancelledError:
                await self.close()
                raise
            self._tap.received(answer)
            if not answer:
                await self.close()
                raise NoAnswer("the other end closed the connection")
            return answer.decode("ascii", "replace").strip()

    async def _answer(self, reader: asyncio.StreamReader) -> bytes:
        """``ack`` comes without a line feed from some versions of the URCap, and with one from others."""
        found = b""
        while not found.endswith(b"\n") and found.strip() != b"ack" and (more := await reader.read(64)):
            found = (found + more).lstrip(b"\r\n")
            if len(found) > 64:
                raise error("PROTOCOL_VIOLATION", f"{self._name} sent {found[:40]!r}")
        return found
