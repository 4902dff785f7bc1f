"""The wires of one station: TCP and a serial line, with power that can be cut."""

import asyncio
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from fakes.faults.vocabulary import Link
from fakes.geocom.conversation import Conversation, LineFaults
from fakes.geocom.instrument import Instrument
from fakes.wire.listening import Listener, TcpPlace
from fakes.wire.terminal import PseudoTerminal


class Wire(Protocol):
    """Another wire of the same instrument, which shares its power."""

    listener: Listener

    async def start(self) -> None: ...
    async def stop(self) -> None: ...
    def cut(self, reset: bool = False) -> None: ...
    def junk(self, data: bytes) -> None: ...


class StationWires:
    """Everybody on any wire talks to the same ``instrument``; ``more`` is a wire that speaks otherwise."""

    def __init__(
        self,
        instrument: Instrument,
        places: Iterable[TcpPlace],
        line: Path | None = None,
        faults: LineFaults | None = None,
        more: "Wire | None" = None,
    ) -> None:
        self.instrument, self.faults, self._more = instrument, faults or LineFaults(), more
        self.clients: set[Client] = set()
        self._listener = Listener(lambda: Client(self), places)
        self._serial: Conversation | None = None
        self.line = PseudoTerminal(line, self.faults.link, self._on_line) if line is not None else None

    @property
    def addresses(self) -> list[tuple[str, int]]:
        """Where it listens; the ports are known after :meth:`start`."""
        return self._listener.addresses

    @property
    def accepting(self) -> bool:
        """Whether connections are accepted."""
        return self._listener.accepting

    async def start(self) -> None:
        """Listen; ``OSError`` when an address is taken, and then nothing is left open."""
        try:
            await self.listen()
            self._open_line()
            if self._more is not None:
                await self._more.start()
        except OSError:
            await self.stop()
            raise

    async def stop(self) -> None:
        """Close everything."""
        self._listener.off = True
        self._listener.refuse()
        for client in tuple(self.clients):
            client.close(abort=True)
        await self._listener.closed()
        self._close_line()
        if self._more is not None:
            await self._more.stop()

    async def listen(self) -> None:
        """Accept connections; not while it is without power."""
        for listener in self._listeners:
            await listener.listen()

    def refuse(self) -> None:
        """Accept no connections; open ones stay."""
        for listener in self._listeners:
            listener.refuse()

    def cut(self, reset: bool = False) -> None:
        """End open connections, with FIN or with RST."""
        for client in tuple(self.clients):
            client.close(reset)
        if self._more is not None:
            self._more.cut(reset)

    def junk(self, data: bytes) -> None:
        """Send bytes that nobody asked for, on every wire."""
        for client in self.clients:
            client.send(data)
        if self.line is not None:
            self.line.send(data)
        if self._more is not None:
            self._more.junk(data)

    async def reboot(self, boot_s: float, serial: str | None = None) -> None:
        """Lose power for ``boot_s``: connections go, the line is dead, settings and lock are gone."""
        self._switch(off=True)
        self.refuse()
        self.cut(reset=True)
        self._end_serial()
        self.instrument.tracker.restart(self.instrument.now())
        self.instrument.restart(serial)
        await asyncio.sleep(boot_s)
        self._switch(off=False)
        if self.line is not None and self.line.link is not None:
            self._serial = Conversation(self.instrument, self.line.link, self.faults)
        await self.listen()

    @property
    def _listeners(self) -> list[Listener]:
        return [self._listener] + ([] if self._more is None else [self._more.listener])

    def _switch(self, off: bool) -> None:
        for listener in self._listeners:
            listener.off = off

    def _open_line(self) -> None:
        if self.line is not None:
            self._serial = Conversation(self.instrument, self.line.open(), self.faults)

    def _close_line(self) -> None:
        self._end_serial()
        if self.line is not None:
            self.line.close()

    def _end_serial(self) -> None:
        if self._serial is not None:
            self._serial.close()
            self._serial = None

    def _on_line(self, data: bytes) -> None:
        if self._serial is not None:
            self._serial.received(data)


class Client(asyncio.Protocol):
    """One TCP connection."""

    def __init__(self, wires: StationWires) -> None:
        self._wires = wires
        self._link: Link | None = None
        self._conversation: Conversation | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link = Link.over(transport, self._wires.faults.link)
        if not self._wires.accepting:  # it was on its way when the listener closed
            self._link.close(reset=True)
            return
        self._wires.clients.add(self)
        self._conversation = Conversation(self._wires.instrument, self._link, self._wires.faults)

    def connection_lost(self, exc: Exception | None) -> None:
        self._forget()

    def data_received(self, data: bytes) -> None:
        if self._conversation is not None and not self._wires.faults.link.half_open:
            self._conversation.received(data)

    def send(self, data: bytes) -> None:
        """Queue bytes."""
        if self._link is not None:
            self._link.send(data)

    def close(self, reset: bool = False, abort: bool = False) -> None:
        """End the connection: FIN, or RST with ``reset``; ``abort`` does not wait for who reads nothing."""
        self._forget()
        if self._link is not None:
            self._link.close(reset)
            if abort:
                self._link.transport.abort()

    def _forget(self) -> None:
        self._wires.clients.discard(self)
        if self._conversation is not None:
            self._conversation.close()
            self._conversation = None
