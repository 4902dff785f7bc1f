"""Bytes to and from an instrument: TCP, a serial line (or a pseudo-terminal), datagrams. No threads."""

import asyncio
import os
import termios
from collections.abc import Callable
from typing import Any, Protocol

import serial

from cell.wire_recording.tap import Tap, tap
from drivers.serial_url import SerialLine
from drivers.tracker.address import NetAddress, TrackerAddress

Received = Callable[[bytes], None]
Lost = Callable[[str], None]


class Link(Protocol):
    """An open connection; after ``close`` neither callback comes any more."""

    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


async def connect(address: TrackerAddress, received: Received, lost: Lost, timeout: float) -> Link:
    """Connect once; ``OSError`` with the reason. ``lost`` is called once when the other end goes away."""
    if isinstance(address, SerialLine):
        return _SerialLink(address, received, lost, tap("tracker", f"serial://{address.path}"))
    link = _NetLink(received, lost, tap("tracker", _place(address)))
    try:
        async with asyncio.timeout(timeout):
            await _create(address, link)
    except TimeoutError as exc:
        raise OSError(f"no connection in {timeout:g} s") from exc
    return link


async def listen(address: NetAddress, received: Received, lost: Lost, only_from: str | None) -> Link:
    """Take datagrams that arrive at ``address``, of one sender if ``only_from`` names it; ``OSError``."""
    link = _NetLink(received, lost, tap("tracker", _place(address)), only_from)
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(lambda: link, local_addr=(address.host, address.port))
    return link


class Lines:
    """Cuts a stream of bytes at CR and LF. Empty lines are none; one that does not end is dropped."""

    def __init__(self, longest: int = 4096) -> None:
        self.dropped = 0
        self._longest, self._rest, self._skipping = longest, b"", False

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that are complete with ``data``."""
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if lines and self._skipping:
            lines, self._skipping = lines[1:], False
        if len(self._rest) > self._longest or self._skipping:
            self.dropped += not self._skipping
            self._rest, self._skipping = b"", True
        return [line for line in lines if line.strip()]

    def clear(self) -> None:
        """Forget a line that has begun."""
        self._rest, self._skipping = b"", False


class _NetLink(asyncio.Protocol, asyncio.DatagramProtocol):
    """A TCP connection, or a socket for datagrams, each of which ends a line."""

    def __init__(self, received: Received, lost: Lost, told: Tap, only_from: str | None = None) -> None:
        self._received, self._lost, self._tap, self._only_from = received, lost, told, only_from
        self._transport: Any = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        if self._transport is not None:
            self._tap.received(data)
            self._received(data)

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        if self._only_from in (None, addr[0]):
            self.data_received(data + b"\n")

    def error_received(self, exc: Exception) -> None:
        """A datagram of ours found nobody; that there is no answer shows in time."""

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._transport = None
            self._lost(str(exc) if exc else "the other end closed the connection")

    def write(self, data: bytes) -> None:
        self._tap.sent(data)
        if isinstance(self._transport, asyncio.DatagramTransport):
            self._transport.sendto(data)
        elif self._transport is not None:
            self._transport.write(data)

    def close(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.abort()
        self._tap.closed()


def _place(address: NetAddress) -> str:
    return f"{address.scheme}://{address.host}:{address.port}"


async def _create(address: NetAddress, link: _NetLink) -> None:
    loop = asyncio.get_running_loop()
    if address.scheme == "tcp":
        await loop.create_connection(lambda: link, address.host, address.port)
    else:
        await loop.create_datagram_endpoint(lambda: link, remote_addr=(address.host, address.port))


class _SerialLink:
    """A tty that pyserial has set up, read when the loop sees something."""

    def __init__(self, line: SerialLine, received: Received, lost: Lost, told: Tap) -> None:
        self._received, self._lost, self._unsent, self._tap = received, lost, b"", told
        try:
            self._port: Any = serial.Serial(
                line.path, line.baudrate, parity=line.parity, stopbits=line.stopbits, exclusive=True
            )
        except (OSError, termios.error, ValueError) as exc:  # SerialException is an OSError
            raise OSError(str(exc)) from exc
        self._fd: int | None = self._port.fileno()
        os.set_blocking(self._fd, False)
        asyncio.get_running_loop().add_reader(self._fd, self._readable, self._fd)

    def write(self, data: bytes) -> None:
        if self._fd is None:
            return
        if not self._unsent:
            asyncio.get_running_loop().add_writer(self._fd, self._writable, self._fd)
        self._tap.sent(data)
        self._unsent += data

    def close(self) -> None:
        fd, self._fd = self._fd, None
        if fd is not None:
            loop = asyncio.get_running_loop()
            loop.remove_reader(fd)
            loop.remove_writer(fd)
            self._port.close()
            self._tap.closed()

    def _readable(self, fd: int) -> None:
        try:
            data = os.read(fd, 65536)
        except BlockingIOError:
            return
        except OSError as exc:
            self._end(f"the serial line failed: {exc.strerror}")
            return
        if data:
            self._tap.received(data)
            self._received(data)
        else:
            self._end("the serial line was closed")

    def _writable(self, fd: int) -> None:
        try:
            self._unsent = self._unsent[os.write(fd, self._unsent) :]
        except BlockingIOError:
            return
        except OSError as exc:
            self._end(f"the serial line failed: {exc.strerror}")
            return
        if not self._unsent:
            asyncio.get_running_loop().remove_writer(fd)

    def _end(self, reason: str) -> None:
        self.close()
        self._lost(reason)
