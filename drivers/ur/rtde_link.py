"""One RTDE connection on the event loop: handshake, then every data package with its arrival time.

The socket is read by a plain reader callback rather than through a stream: a package costs one ``recv``,
and :meth:`RtdeLink.drain` can read what the kernel already holds before anyone calls the state stale.
"""

import asyncio
import socket
from collections.abc import Callable, Sequence

from cell.answer_time import answer_within
from cell.clock import Clock
from cell.errors import CellError, error
from cell.wire_recording.tap import tap
from drivers.ur import rtde
from drivers.ur.refused import why
from drivers.ur.rtde import Package, PackageType, Recipe, Splitter

PORT = 30004

OnData = Callable[[bytes, float], None]
OnLost = Callable[[CellError], None]


class RtdeLink:
    """A connected RTDE client. It never reconnects; the first failure is reported once and ends it."""

    def __init__(self, host: str, sock: socket.socket, clock: Clock, on_lost: OnLost) -> None:
        self.host = host
        self.messages = 0
        self._sock, self._clock, self._on_lost = sock, clock, on_lost
        self._loop = asyncio.get_running_loop()
        self._splitter = Splitter()
        self._on_data: OnData | None = None
        self._reply: asyncio.Future[Package] | None = None
        self._reply_kind: PackageType | None = None
        self._closed = False
        self._failure: CellError | None = None
        self._tap = tap("rtde", f"{host}:{PORT}")
        self._loop.add_reader(sock.fileno(), self.drain)

    @classmethod
    async def connect(cls, host: str, clock: Clock, on_lost: OnLost, timeout: float) -> "RtdeLink":
        """Connect and agree on protocol version 2; ``DEVICE_UNREACHABLE`` when that fails in time."""
        try:
            sock = await open_socket(host, PORT, timeout)
        except (OSError, TimeoutError) as exc:
            raise error("DEVICE_UNREACHABLE", f"RTDE at {host}:{PORT}: {why(exc, PORT)}") from exc
        link = cls(host, sock, clock, on_lost)
        try:
            reply = await link.request(rtde.request_version(), PackageType.VERSION, timeout)
            if not rtde.parse_flag(reply):
                raise error("PROTOCOL_VIOLATION", f"{host} refuses RTDE version {rtde.VERSION}")
        except BaseException:
            link.close()
            raise
        return link

    async def controller_version(self, timeout: float) -> tuple[int, int, int, int]:
        """PolyScope's major, minor, bugfix and build number."""
        reply = await self.request(
            rtde.encode(PackageType.CONTROLLER_VERSION), PackageType.CONTROLLER_VERSION, timeout
        )
        return rtde.parse_controller_version(reply.payload)

    async def setup_outputs(self, names: Sequence[str], frequency_hz: float, timeout: float) -> Recipe:
        """Choose what every data package carries; types may be ``NOT_FOUND``, which the caller judges."""
        reply = await self.request(rtde.request_outputs(names, frequency_hz), PackageType.OUTPUTS, timeout)
        return rtde.parse_recipe(names, reply.payload)

    async def setup_inputs(self, names: Sequence[str], timeout: float) -> Recipe:
        """Claim input variables for writing; id 0 when one is ``NOT_FOUND`` or ``IN_USE``."""
        reply = await self.request(rtde.request_inputs(names), PackageType.INPUTS, timeout)
        return rtde.parse_recipe(names, reply.payload)

    async def send(self, values: bytes) -> None:
        """Write the packed values of an input recipe; ``DEVICE_LOST`` when the link is gone."""
        if self._failure is not None:
            raise self._failure
        try:
            data = rtde.encode(PackageType.DATA, values)
            self._tap.sent(data)
            await self._loop.sock_sendall(self._sock, data)
        except OSError as exc:
            raise error("DEVICE_LOST", f"RTDE to {self.host}: {exc}") from exc

    async def start(self, on_data: OnData, timeout: float) -> None:
        """Start the stream: ``on_data(payload, arrival)`` on every package from now on."""
        self._on_data = on_data
        reply = await self.request(rtde.encode(PackageType.START), PackageType.START, timeout)
        if not rtde.parse_flag(reply):
            raise error("PROTOCOL_VIOLATION", f"{self.host} refuses to start the RTDE stream")

    async def request(self, data: bytes, kind: PackageType, timeout: float) -> Package:
        """Send a request and return the reply of the same type; texts in between are kept aside."""
        if self._failure is not None:
            raise self._failure
        reply: asyncio.Future[Package] = self._loop.create_future()
        self._reply, self._reply_kind = reply, kind
        try:
            async with answer_within(timeout):
                self._tap.sent(data)
                await self._loop.sock_sendall(self._sock, data)
                return await reply
        except TimeoutError:
            raise error(
                "CALL_TIMEOUT", f"RTDE request {kind.name} to {self.host} had no reply in {timeout:g} s"
            ) from None
        except OSError as exc:
            raise error("DEVICE_LOST", f"RTDE to {self.host}: {exc}") from exc
        finally:
            self._reply = self._reply_kind = None

    def drain(self) -> None:
        """Read and handle everything that has arrived; harmless on a closed link."""
        while not self._closed:
            try:
                data = self._sock.recv(65536)
            except (BlockingIOError, InterruptedError):
                return
            except OSError as exc:
                self._fail(error("DEVICE_LOST", f"RTDE to {self.host}: {exc}"))
                return
            if not data:
                self._fail(error("DEVICE_LOST", f"{self.host} closed the RTDE connection"))
                return
            arrival = self._clock.now()
            self._tap.received(data, arrival)
            try:
                self._take(data, arrival)
            except CellError as exc:
                self._fail(exc)
                return
            if len(data) < 65536:
                return

    def close(self) -> None:
        """End the connection; nothing is reported any more."""
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._sock.fileno())
            self._sock.close()
            self._tap.closed()

    def _take(self, data: bytes, arrival: float) -> None:
        for package in self._splitter.feed(data):
            if package.kind is PackageType.DATA:
                if self._on_data is not None:
                    self._on_data(package.payload, arrival)
            elif package.kind is PackageType.MESSAGE:
                self.messages += 1
            elif package.kind is self._reply_kind and self._reply is not None:
                if not self._reply.done():
                    self._reply.set_result(package)
            else:
                raise error("PROTOCOL_VIOLATION", f"{self.host} sent {package.kind.name} unasked")

    def _fail(self, failure: CellError) -> None:
        self.close()
        self._failure = failure
        if self._reply is not None and not self._reply.done():
            self._reply.set_exception(failure)
        else:
            self._on_lost(failure)


async def open_socket(host: str, port: int, timeout: float) -> socket.socket:
    """A connected non-blocking TCP socket with small packets sent at once. OSError or TimeoutError."""
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(timeout):
        infos = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, kind, proto, _, address = infos[0]
        sock = socket.socket(family, kind, proto)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await loop.sock_connect(sock, address)
        except BaseException:
            sock.close()
            raise
        return sock
