"""Modbus over TCP or TLS: MBAP framing and connections, any number of requests in flight on each.

A stream that is not Modbus is closed at its first nonsensical header, for there is no way to find the next
frame. Requests of one connection are processed in order, and read no faster than they are answered.
"""

import asyncio
import struct
from collections.abc import Callable
from dataclasses import dataclass

from fakes.faults.vocabulary import Link
from fakes.modbus_io.service import Service

HEADER = struct.Struct(">HHHB")  # transaction, protocol (0), bytes that follow with the unit, unit
LENGTH_RANGE = range(2, 255)
MOST_UNREAD = 4096
MOST_CONNECTIONS = 256


class FramingError(ValueError):
    """The header cannot be Modbus."""


@dataclass(frozen=True)
class Request:
    """One frame: what to answer with, whom, and the function code with its data."""

    transaction: int
    unit: int
    pdu: bytes


class Framer:
    """Cuts a byte stream into requests, however it arrives."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def __len__(self) -> int:
        """Bytes that wait."""
        return len(self._buffer)

    def feed(self, data: bytes) -> None:
        self._buffer += data

    def next(self) -> Request | None:
        """The next whole request, or None; :class:`FramingError` for a header that is nonsense."""
        if len(self._buffer) < HEADER.size:
            return None
        transaction, protocol, length, unit = HEADER.unpack_from(self._buffer)
        if protocol != 0 or length not in LENGTH_RANGE:
            raise FramingError(f"protocol {protocol}, length {length}")
        end = HEADER.size + length - 1
        if len(self._buffer) < end:
            return None
        pdu = bytes(self._buffer[HEADER.size : end])
        del self._buffer[:end]
        return Request(transaction, unit, pdu)


def frame(transaction: int, unit: int, pdu: bytes) -> bytes:
    """A whole frame."""
    return HEADER.pack(transaction, 0, len(pdu) + 1, unit) + pdu


class Connections:
    """The open connections of one module, over TCP and TLS alike; the one silent longest makes room."""

    def __init__(self, service: Service, accepting: Callable[[], bool]) -> None:
        self.service, self.accepting = service, accepting
        self._open: dict[Connection, None] = {}  # in the order in which they were last heard

    def __len__(self) -> int:
        return len(self._open)

    def heard(self, connection: "Connection") -> None:
        """Note that a connection is new or has said something."""
        self._open.pop(connection, None)
        if len(self._open) >= MOST_CONNECTIONS:
            next(iter(self._open)).close()
        self._open[connection] = None

    def gone(self, connection: "Connection") -> None:
        self._open.pop(connection, None)

    def close_all(self, reset: bool = False) -> None:
        """End every connection: FIN, or RST with ``reset``."""
        for connection in tuple(self._open):
            connection.close(reset)

    def abort_all(self) -> None:
        """End every connection without waiting for clients that read nothing."""
        for connection in tuple(self._open):
            connection.abort()

    def send_all(self, data: bytes) -> None:
        """Send the same bytes to everybody."""
        for connection in self._open:
            connection.send(data)


class Connection(asyncio.Protocol):
    """One client."""

    def __init__(self, connections: Connections) -> None:
        self._connections, self._service = connections, connections.service
        self._framer = Framer()
        self._link: Link | None = None
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link = Link.over(transport, self._service.faults.link)
        if self._connections.accepting():
            self._connections.heard(self)
        else:  # it was on its way when the listener closed
            self._link.close(reset=True)

    def connection_lost(self, exc: Exception | None) -> None:
        self._connections.gone(self)
        self._forget()

    def data_received(self, data: bytes) -> None:
        link = self._link
        if link is None or self._service.faults.link.half_open or link.transport.is_closing():
            return
        self._connections.heard(self)
        self._framer.feed(data)
        if self._timer is None:
            self._take(link)

    def send(self, data: bytes) -> None:
        """Queue bytes; a client that reads nothing is cut off."""
        if self._link is not None:
            self._link.send(data)

    def close(self, reset: bool = False) -> None:
        """End the connection: FIN, or RST with ``reset``."""
        self._connections.gone(self)
        self._forget()
        if self._link is not None:
            self._link.close(reset)

    def abort(self) -> None:
        """End the connection, and what waits to be sent with it."""
        self.close()
        if self._link is not None:
            self._link.transport.abort()

    def _take(self, link: Link) -> None:
        """Begin the next request, one at a time."""
        if link.transport.is_closing():
            return
        try:
            request = self._framer.next()
        except FramingError:
            self.close()
            return
        if request is not None:
            self._timer = self._service.later(lambda: self._answer(link, request))
        if len(self._framer) > MOST_UNREAD:
            link.transport.pause_reading()
        else:
            link.transport.resume_reading()

    def _answer(self, link: Link, request: Request) -> None:
        self._timer = None
        reply = self._service.reply(request.pdu)
        self._service.send(link, frame(request.transaction, request.unit, reply))
        self._take(link)

    def _forget(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
