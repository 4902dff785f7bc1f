"""A Modbus TCP server: framing, connections and their limits. What the registers mean is the bank's business.

Every request of a segment is answered, in order. A stream that is not Modbus is closed at its first bad
header: TCP gives no way to find the next frame, and a client that is closed connects again.

Clients that may write are served before strangers: a stranger never takes the place of one of them, a place
is kept for them, and the rate at which strangers are accepted is limited.
"""

import asyncio
import logging
import ssl
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from cell.clock import Clock
from cell.errors import error, present
from daemon.modbus.pdu import SERVER_FAILURE, Bank, respond

log = logging.getLogger("cellward.modbus")

HEADER = struct.Struct(">HHHB")  # transaction, protocol (0), length of what follows, unit
MAX_LENGTH = 254
FRAME_TIMEOUT_S = 2.0
KEPT_PLACES = 2  # for clients that may write, of the places there are, never the last one
STRANGER_A_SECOND = 2.0  # connections accepted of one stranger's address; it may open some at once
STRANGER_AT_ONCE = 20.0
MAX_ADDRESSES = 256  # whose rate is kept; the others share one
TOLD_EVERY_S = 60.0  # one line at most about each kind of trouble that clients make


@dataclass
class _Connection:
    """One client, whether it ever spoke Modbus, and when it was last heard."""

    task: asyncio.Task[None]
    transport: asyncio.WriteTransport
    client: str
    listed: bool
    heard: float
    spoke: bool = False
    leaving: bool = False


class ModbusServer:
    """Serves ``bank`` to any unit id.

    ``listed(client)`` says who may write. When there is no place left, the connection silent longest is
    closed, a stranger's before a listed client's; a stranger takes only a stranger's place. With ``tls`` no
    connection is in plain text.
    """

    def __init__(
        self,
        bank: Bank,
        clock: Clock,
        host: str,
        port: int,
        max_connections: int,
        idle_timeout_s: float,
        listed: Callable[[str], bool] = lambda client: True,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self._bank, self._clock, self._listed = bank, clock, listed
        self._host, self._port, self._tls = host, port, tls
        self._max, self._idle_s = max_connections, idle_timeout_s
        self._server: asyncio.Server | None = None
        self._connections: dict[asyncio.Task[None], _Connection] = {}
        self._failing = False
        self._allowances: dict[str, tuple[float, float]] = {}
        self._told: dict[str, tuple[float, int]] = {}
        self.evicted = self.turned_away = 0

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
            self._server = await asyncio.start_server(
                self._serve,
                self._host,
                self._port,
                ssl=self._tls,
                ssl_handshake_timeout=None if self._tls is None else FRAME_TIMEOUT_S,
            )
        except OSError as exc:
            where = f"[modbus] bind {self._host}:{self._port}"
            raise error("ADDRESS_NOT_SERVED", f"{where}: {exc.strerror or exc}") from exc

    async def stop(self) -> None:
        """Close the listener and every connection."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        tasks = tuple(self._connections)
        for connection in self._connections.values():
            self._close(connection)
        if tasks:
            _, stuck = await asyncio.wait(tasks, timeout=2.0)
            for task in stuck:
                task.cancel()
        if server is not None:
            await server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = present(asyncio.current_task(), "task of the connection")
        peer = writer.get_extra_info("peername")
        client = str(peer[0]) if peer else "unknown"
        connection = _Connection(task, writer.transport, client, self._listed(client), self._clock.now())
        if not self._admitted(connection):
            self.turned_away += 1
            self._tell(f"clients outside allow_clients were turned away, such as {client}", "turned away")
            writer.transport.abort()
            return
        self._connections[task] = connection
        try:
            await self._converse(connection, reader, writer)
        except (OSError, asyncio.IncompleteReadError, TimeoutError):
            pass  # the client went away, was silent too long, reads nothing, or was closed for another
        finally:
            del self._connections[task]
            writer.transport.abort()
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(1.0):
                    await writer.wait_closed()

    async def _converse(
        self, connection: _Connection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        while not connection.leaving:
            async with asyncio.timeout(self._idle_s):
                first = await reader.readexactly(1)
            async with asyncio.timeout(FRAME_TIMEOUT_S):
                head = HEADER.unpack(first + await reader.readexactly(HEADER.size - 1))
                transaction, protocol, length, unit = head
                if protocol != 0 or not 2 <= length <= MAX_LENGTH:
                    self._tell(f"{connection.client} does not speak Modbus, connection closed", "garbage")
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

    def _admitted(self, new: _Connection) -> bool:
        """Whether ``new`` gets a place, which another connection may have to leave for it."""
        if not new.listed and not self._in_time(new.client):
            return False
        staying = [c for c in self._connections.values() if not c.leaving]
        strangers = [c for c in staying if not c.listed]
        free = self._max - len(staying)
        if new.listed:
            if free <= 0:
                self._evict(strangers or staying)
            return True
        listed = len(staying) - len(strangers)
        open_to_strangers = self._max - max(listed, min(KEPT_PLACES, self._max - 1))
        if len(strangers) < open_to_strangers:
            return True
        if not strangers:
            return False
        self._evict(strangers)
        return True

    def _in_time(self, client: str) -> bool:
        """Take one of the accepts that a stranger's address has; False when it has used them up."""
        now = self._clock.now()
        if client not in self._allowances and len(self._allowances) >= MAX_ADDRESSES:
            refilled_s = STRANGER_AT_ONCE / STRANGER_A_SECOND
            self._allowances = {k: v for k, v in self._allowances.items() if now - v[1] < refilled_s}
            if len(self._allowances) >= MAX_ADDRESSES:
                client = "others"
        left, at = self._allowances.get(client, (STRANGER_AT_ONCE, now))
        left = min(left + STRANGER_A_SECOND * (now - at), STRANGER_AT_ONCE)
        self._allowances[client] = (left - 1.0 if left >= 1.0 else left), now
        return left >= 1.0

    def _evict(self, candidates: list[_Connection]) -> None:
        """Close the one silent longest; one that never spoke goes before one that polls."""
        silent = min(candidates, key=lambda connection: (connection.spoke, connection.heard))
        self._close(silent)
        self.evicted += 1
        self._tell(
            f"more than [modbus] max_connections = {self._max}; closed the one of {silent.client} that was "
            "silent longest",
            "evicted",
        )

    def _close(self, connection: _Connection) -> None:
        """End a connection by its transport: its task then ends by itself.

        The callback that asyncio's streams put on the task reports a cancelled one as an unhandled error.
        """
        connection.leaving = True
        connection.transport.abort()

    def _tell(self, text: str, kind: str) -> None:
        """One line for each kind in a time, with the number of those left out: clients decide how many."""
        now = self._clock.now()
        told_at, left_out = self._told.get(kind, (-TOLD_EVERY_S, 0))
        if kind in self._told and now - told_at < TOLD_EVERY_S:
            self._told[kind] = (told_at, left_out + 1)
            return
        self._told[kind] = (now, 0)
        log.warning("%s%s", text, f" ({left_out} more since the last such line)" if left_out else "")
