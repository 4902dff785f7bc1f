"""A Modbus TCP server: framing, connections and their limits. What the registers mean is the bank's business.

Every request of a segment is answered, in order. A stream that is not Modbus is closed at its first bad
header: TCP gives no way to find the next frame, and a client that is closed connects again.
"""

import asyncio
import logging
import struct
from contextlib import suppress
from dataclasses import dataclass

from cell.clock import Clock
from cell.errors import error
from daemon.modbus.pdu import SERVER_FAILURE, Bank, respond

log = logging.getLogger("cellward.modbus")

HEADER = struct.Struct(">HHHB")  # transaction, protocol (0), length of what follows, unit
MAX_LENGTH = 254
FRAME_TIMEOUT_S = 2.0


@dataclass
class _Connection:
    """One client, whether it ever spoke Modbus, and when it was last heard."""

    task: asyncio.Task[None]
    client: str
    heard: float
    spoke: bool = False
    leaving: bool = False


class ModbusServer:
    """Serves ``bank`` to any unit id. When it is full, the one silent longest goes, strangers first."""

    def __init__(
        self, bank: Bank, clock: Clock, host: str, port: int, max_connections: int, idle_timeout_s: float
    ) -> None:
        self._bank, self._clock = bank, clock
        self._host, self._port = host, port
        self._max, self._idle_s = max_connections, idle_timeout_s
        self._server: asyncio.Server | None = None
        self._connections: dict[asyncio.Task[None], _Connection] = {}
        self._failing = False
        self.evicted = 0

    @property
    def address(self) -> tuple[str, int]:
        """Where the server listens; the port is known after :meth:`start`."""
        if self._server is None:
            return self._host, self._port
        host, port = self._server.sockets[0].getsockname()[:2]
        return host, port

    async def start(self) -> None:
        """Listen; ``ADDRESS_NOT_SERVED`` when the address is taken or not ours."""
        try:
            self._server = await asyncio.start_server(self._serve, self._host, self._port)
        except OSError as exc:
            where = f"[modbus] bind {self._host}:{self._port}"
            raise error("ADDRESS_NOT_SERVED", f"{where}: {exc.strerror or exc}") from exc

    async def stop(self) -> None:
        """Close the listener and every connection."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        tasks = tuple(self._connections)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=2.0)
        if server is not None:
            await server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        peer = writer.get_extra_info("peername")
        connection = _Connection(task, str(peer[0]) if peer else "unknown", self._clock.now())
        self._make_room()
        self._connections[task] = connection
        try:
            await self._converse(connection, reader, writer)
        except (OSError, asyncio.IncompleteReadError, TimeoutError):
            pass  # the client went away, was silent too long, or reads nothing
        finally:
            del self._connections[task]
            writer.transport.abort()
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(1.0):
                    await writer.wait_closed()

    async def _converse(
        self, connection: _Connection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        while True:
            async with asyncio.timeout(self._idle_s):
                first = await reader.readexactly(1)
            async with asyncio.timeout(FRAME_TIMEOUT_S):
                head = HEADER.unpack(first + await reader.readexactly(HEADER.size - 1))
                transaction, protocol, length, unit = head
                if protocol != 0 or not 2 <= length <= MAX_LENGTH:
                    log.info("%s does not speak Modbus, connection closed", connection.client)
                    return
                request = await reader.readexactly(length - 1)
            connection.heard, connection.spoke = self._clock.now(), True
            reply = self._reply(request, connection.client)
            writer.write(HEADER.pack(transaction, 0, len(reply) + 1, unit) + reply)
            async with asyncio.timeout(FRAME_TIMEOUT_S):
                await writer.drain()
            # Neither reading what has arrived nor writing waits: without this a full segment holds the loop.
            await asyncio.sleep(0)

    def _reply(self, request: bytes, client: str) -> bytes:
        """The reply; a defect of ours is exception 4, logged once until requests succeed again."""
        try:
            reply = respond(self._bank, request, client)
        except Exception:
            if not self._failing:
                log.exception("a request of %s could not be answered", client)
            self._failing = True
            return bytes([request[0] | 0x80, SERVER_FAILURE])
        self._failing = False
        return reply

    def _make_room(self) -> None:
        """Evict the connection silent longest; one that never spoke goes before a PLC that polls."""
        staying = [c for c in self._connections.values() if not c.leaving]
        if len(staying) < self._max:
            return
        silent = min(staying, key=lambda connection: (connection.spoke, connection.heard))
        silent.leaving = True
        silent.task.cancel()
        self.evicted += 1
        if self.evicted == 1:
            log.warning("more than %d connections; closed the idle one of %s", self._max, silent.client)
