"""All wires of one module: TCP, TLS and RTU as asked for, with power that can be cut."""

import asyncio
import ssl
from dataclasses import dataclass
from pathlib import Path

from fakes.modbus_io.module import Unit
from fakes.modbus_io.rtu import RtuLine
from fakes.modbus_io.service import Pace, Service
from fakes.modbus_io.tcp import Connection, Connections

BACKLOG = 256
HANDSHAKE_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class TcpPlace:
    """An address to listen on (port 0 takes a free one), with ``tls`` over TLS."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None


class ModuleWires:
    """One module on any number of addresses and at most one serial line."""

    def __init__(
        self, module: Unit, places: tuple[TcpPlace, ...], line: Path | None = None, pace: Pace | None = None
    ) -> None:
        self.service = Service(module, pace or Pace())
        self.connections = Connections(self.service)
        self.line = RtuLine(self.service, line) if line is not None else None
        self._places = list(places)
        self._servers: list[asyncio.Server] = []
        self._closing: set[asyncio.Future[None]] = set()
        self._listening = asyncio.Lock()
        self._off = False

    @property
    def addresses(self) -> list[tuple[str, int]]:
        """Where the TCP wires listen; the ports are known after :meth:`start`."""
        return [(place.host, place.port) for place in self._places]

    async def start(self) -> None:
        """Listen; ``OSError`` when an address is taken, and then nothing is left open."""
        try:
            await self.listen()
            if self.line is not None:
                self.line.open()
        except OSError:
            await self.stop()
            raise

    async def stop(self) -> None:
        """Close everything."""
        self._off = True
        self.refuse()
        self.connections.abort_all()
        await self._closed()
        if self.line is not None:
            self.line.close()

    async def listen(self) -> None:
        """Accept connections; not while the module is without power."""
        async with self._listening:
            await self._closed()
            if self._servers or self._off:
                return
            self.connections.accepting = True
            loop = asyncio.get_running_loop()
            for index, place in enumerate(self._places):
                server = await loop.create_server(
                    lambda: Connection(self.connections),
                    place.host,
                    place.port,
                    ssl=place.tls,
                    backlog=BACKLOG,
                    ssl_handshake_timeout=HANDSHAKE_TIMEOUT_S if place.tls else None,
                )
                self._servers.append(server)
                if not self.connections.accepting:  # refused meanwhile
                    self.refuse()
                    return
                port = server.sockets[0].getsockname()[1]
                self._places[index] = TcpPlace(place.host, port, place.tls)

    def refuse(self) -> None:
        """Stop accepting connections; open ones stay."""
        self.connections.accepting = False
        servers, self._servers = self._servers, []
        loop = asyncio.get_running_loop()
        for server in servers:
            # A server that is closed forgets what it has just accepted, and nobody would ever close that:
            # end the accepting first, and close when those connections are made, to be reset.
            for listener in server.sockets:
                loop.remove_reader(listener)
            closed: asyncio.Future[None] = loop.create_future()
            self._closing.add(closed)
            loop.call_soon(loop.call_soon, self._close, server, closed)

    def _close(self, server: asyncio.Server, closed: "asyncio.Future[None]") -> None:
        server.close()
        self._closing.discard(closed)
        closed.set_result(None)

    async def _closed(self) -> None:
        """Wait until the addresses are free; that takes turns of the loop, not time."""
        if self._closing:
            await asyncio.wait(tuple(self._closing))

    def cut(self, reset: bool = False) -> None:
        """End open connections, with FIN or with RST."""
        self.connections.close_all(reset)

    def junk(self, data: bytes) -> None:
        """Send bytes that nobody asked for, on every wire."""
        self.connections.send_all(data)
        if self.line is not None:
            self.line.send(data)

    async def reboot(self, boot_s: float, serial: str | None = None) -> None:
        """Lose power for ``boot_s``: connections go, nothing answers, counters begin at 0 again."""
        self._power(False)
        self.refuse()
        self.cut(reset=True)
        await asyncio.sleep(boot_s)
        self.service.module.restart(serial)
        self._power(True)
        await self.listen()

    def _power(self, on: bool) -> None:
        self._off = not on
        if self.line is not None:
            self.line.powered = on
            self.line.mute()
