"""A stream of points as lines of text, as a tracker's program exports them."""

import asyncio
import math
from collections.abc import Callable

from fakes.faults.vocabulary import Link
from fakes.geocom.conversation import LineFaults
from fakes.wire.listening import Listener, TcpPlace
from fakes.world.tracker.lines_form import LinesForm
from fakes.world.tracker.tracker import Tracker

_LONGEST_REQUEST = 4096


class LineStream:
    """Sends the readings of ``tracker`` to everybody who connects."""

    def __init__(
        self, tracker: Tracker, form: LinesForm, host: str, now: Callable[[], float], faults: LineFaults
    ) -> None:
        self.form, self.faults = form, faults
        self.clients: set[_Client] = set()
        self.listener = Listener(lambda: _Client(self), [TcpPlace(host, form.port)])
        self._tracker, self._now = tracker, now
        self._start, self._count, self._tried = now(), 0, -math.inf
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Listen; ``OSError`` when the address is taken."""
        await self.listener.listen()
        self._tracker.lock(self._now(), self.form.reflector)
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def stop(self) -> None:
        """Close everything."""
        if self._task is not None:
            self._task.cancel()
        self.listener.off = True
        self.listener.refuse()
        self.cut(reset=True)
        await self.listener.closed()

    def cut(self, reset: bool = False) -> None:
        """End all connections."""
        for client in tuple(self.clients):
            client.close(reset)

    def junk(self, data: bytes) -> None:
        """Send bytes that are no line."""
        for client in self.clients:
            client.send(data)

    def line(self) -> bytes:
        """The line of now."""
        now = self._now()
        self._count += 1
        return self.form.line(self._count, now - self._start, self._tracker.read(now), self._tracker.truth)

    def say(self, client: "_Client") -> None:
        """Send the line of now to one client, unless a fault keeps it back."""
        if self.faults.lose > 0:
            self.faults.lose -= 1
        elif not self.faults.silent:
            client.send(self.line() * (2 if self.faults.duplicate else 1))

    async def _run(self) -> None:
        due = self._now()
        while True:
            due = max(due + self.form.period_s, self._now())
            await asyncio.sleep(due - self._now())
            self._relock()
            if self.form.request is None:
                for client in tuple(self.clients):
                    self.say(client)

    def _relock(self) -> None:
        now = self._now()
        self._tracker.advance(now)
        if self._tracker.target is None and now >= self._tried + self.form.relock_s:
            self._tried, half = now, self._tracker.truth.search_rad
            self._tracker.search(now, half, half)


class _Client(asyncio.Protocol):
    """One connection."""

    def __init__(self, stream: LineStream) -> None:
        self._stream = stream
        self._link: Link | None = None
        self._heard = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link = Link.over(transport, self._stream.faults.link)
        if not self._stream.listener.accepting:  # it was on its way when the listener closed
            self._link.close(reset=True)
            return
        self._stream.clients.add(self)
        self.send(self._stream.form.heading.encode())

    def connection_lost(self, exc: Exception | None) -> None:
        self._stream.clients.discard(self)

    def data_received(self, data: bytes) -> None:
        if self._stream.form.request is None or self._stream.faults.link.half_open:
            return
        asked = self._stream.form.request.encode()
        *requests, self._heard = (self._heard + data)[-_LONGEST_REQUEST:].split(asked)
        for _ in requests:
            self._stream.say(self)

    def send(self, data: bytes) -> None:
        """Queue bytes."""
        if self._link is not None and data:
            self._link.send(data)

    def close(self, reset: bool = False) -> None:
        """End the connection."""
        self._stream.clients.discard(self)
        if self._link is not None:
            self._link.close(reset)
