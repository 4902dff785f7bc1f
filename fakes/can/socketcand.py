"""A gateway with socketcand's protocol: ASCII messages in angle brackets, and stamps of its own clock."""

import asyncio
import re
import time
from collections.abc import Callable

from fakes.can.bus import ERROR_BUS_OFF, CanBus, Frame, Port
from fakes.faults.vocabulary import Link, LinkFaults
from fakes.wire.listening import Listener, TcpPlace

_MESSAGE = re.compile(r"<\s*([^<>]*?)\s*>")
_LONGEST = 512
_MOST_CLIENTS = 16


class Gateway:
    """``channel`` is the name under which clients open the bus."""

    def __init__(
        self, bus: CanBus, channel: str, place: TcpPlace, faults: LinkFaults, now: Callable[[], float]
    ) -> None:
        self.bus, self.channel, self.faults = bus, channel, faults
        self.clock_ahead_s = 0.0  # of the gateway's own clock
        self._now = now
        self._clients: list[_Client] = []
        self._listener = Listener(lambda: _Client(self), (place,))
        bus.off_listeners.append(self._tell_off)

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens; the port is known after :meth:`listen`."""
        return self._listener.addresses[0]

    async def listen(self) -> None:
        """Accept clients; ``OSError`` when the address is taken."""
        await self._listener.listen()

    def refuse(self) -> None:
        """Accept nobody, and end the connections that there are."""
        self._listener.refuse()
        self.cut(reset=True)

    async def stop(self) -> None:
        """Close everything for good."""
        self._listener.off = True
        self.refuse()
        await self._listener.closed()

    def cut(self, reset: bool = False) -> None:
        """End the connections, with FIN or with RST."""
        for client in tuple(self._clients):
            client.close(reset)

    def junk(self) -> None:
        """Messages that are no frames, and one that is cut off."""
        for client in self._clients:
            client.say_raw(b"< frame zz 1.0 00 >< nonsense >< frame 185 >")

    def stamp(self, t: float) -> str:
        """Seconds of the gateway's clock at ``t`` (s) of ours."""
        return f"{time.time() - self._now() + t + self.clock_ahead_s:.6f}"

    def admit(self, client: "_Client") -> bool:
        """Whether a new client may stay."""
        if not self._listener.accepting or len(self._clients) >= _MOST_CLIENTS:
            return False
        self._clients.append(client)
        return True

    def forget(self, client: "_Client") -> None:
        if client in self._clients:
            self._clients.remove(client)

    def now(self) -> float:
        return self._now()

    def _tell_off(self) -> None:
        for client in self._clients:
            if client.open:
                client.say(f"error {ERROR_BUS_OFF:03X} {self.stamp(self._now())}")


class _Client(asyncio.Protocol):
    """One connection; frames come once the client has opened the bus in raw mode."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._link: Link | None = None
        self._text = ""
        self._opened = False
        self.open = False
        self._port: Port | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link = Link.over(transport, self._gateway.faults)
        if not self._gateway.admit(self):
            self._link.close(reset=True)
            return
        self.say("hi")

    def connection_lost(self, exc: Exception | None) -> None:
        self._gone()

    def data_received(self, data: bytes) -> None:
        if self._gateway.faults.half_open:
            return
        self._text += data.decode("ascii", "replace")
        end = 0
        for found in _MESSAGE.finditer(self._text):
            end = found.end()
            self._handle(found[1])
        self._text = self._text[end:][-_LONGEST:]

    def say(self, words: str) -> None:
        """Send one message."""
        self.say_raw(f"< {words} >".encode("ascii"))

    def say_raw(self, data: bytes) -> None:
        if self._link is not None:
            self._link.send(data)

    def close(self, reset: bool = False) -> None:
        self._gone()
        if self._link is not None:
            self._link.close(reset)

    def _gone(self) -> None:
        self.open = False
        self._gateway.forget(self)
        port, self._port = self._port, None
        if port is not None:
            port.leave()

    def _handle(self, words: str) -> None:
        match words.split():
            case ["open", channel] if not self._opened:
                if channel != self._gateway.channel:
                    self.say("error could not open bus")
                    return
                self._opened = True
                self.say("ok")
            case ["rawmode"] if self._opened:
                if self._port is None:
                    self._port = self._gateway.bus.join(self._receive)
                self.open = True
                self.say("ok")
            case ["echo"]:
                self.say("echo")
            case ["send", identifier, length, *data] if self.open:
                self._transmit(identifier, length, data)
            case _:
                self.say("error unknown command")

    def _transmit(self, identifier: str, length: str, data: list[str]) -> None:
        try:
            number, values = int(identifier, 16), bytes(int(value, 16) for value in data)
            if len(values) != int(length, 16) or len(values) > 8:
                raise ValueError(length)
        except ValueError:
            self.say("error syntax error in send command")
            return
        if self._port is not None:
            self._port.send(Frame(number, values, extended=len(identifier) > 3), self._gateway.now())

    def _receive(self, frame: Frame, t: float) -> None:
        if self.open and not frame.remote:
            identifier = f"{frame.id:08X}" if frame.extended else f"{frame.id:03X}"
            self.say(f"frame {identifier} {self._gateway.stamp(t)} {frame.data.hex().upper()}")
