"""Listening on TCP as a device does that can lose its power: connections are refused, and accepted again."""

import asyncio
import ssl
from collections.abc import Callable, Iterable
from dataclasses import dataclass

BACKLOG = 256
HANDSHAKE_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class TcpPlace:
    """An address to listen on (port 0 takes a free one), with ``tls`` over TLS."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None


class Listener:
    """Makes a ``protocol`` for everybody who connects to one of ``places`` while it listens.

    A protocol that is made while :attr:`accepting` is False was on its way when the listener closed; it has
    to reset its connection. Nobody makes it listen while it is :attr:`off`.
    """

    def __init__(self, protocol: Callable[[], asyncio.Protocol], places: Iterable[TcpPlace]) -> None:
        self.accepting = self.off = False
        self._protocol, self._places = protocol, list(places)
        self._servers: list[asyncio.Server] = []
        self._closing: set[asyncio.Future[None]] = set()
        self._turn = asyncio.Lock()

    @property
    def addresses(self) -> list[tuple[str, int]]:
        """Where it listens; the ports are known after :meth:`listen`."""
        return [(place.host, place.port) for place in self._places]

    async def listen(self) -> None:
        """Accept connections; ``OSError`` when an address is taken."""
        async with self._turn:
            await self.closed()
            if self._servers or self.off:
                return
            self.accepting = True
            loop = asyncio.get_running_loop()
            for index, place in enumerate(self._places):
                server = await loop.create_server(
                    self._protocol,
                    place.host,
                    place.port,
                    ssl=place.tls,
                    backlog=BACKLOG,
                    ssl_handshake_timeout=HANDSHAKE_TIMEOUT_S if place.tls else None,
                )
                self._servers.append(server)
                if not self.accepting:  # refused meanwhile
                    self.refuse()
                    return
                port = server.sockets[0].getsockname()[1]
                self._places[index] = TcpPlace(place.host, port, place.tls)

    def refuse(self) -> None:
        """Stop accepting connections; open ones stay."""
        self.accepting = False
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

    async def closed(self) -> None:
        """Wait until refused addresses are free; that takes turns of the loop, not time."""
        if self._closing:
            await asyncio.wait(tuple(self._closing))

    def _close(self, server: asyncio.Server, closed: "asyncio.Future[None]") -> None:
        server.close()
        self._closing.discard(closed)
        closed.set_result(None)
