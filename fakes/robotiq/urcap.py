"""The socket that the gripper's URCap opens on the arm's controller: ``GET POS`` and ``SET POS 255 GTO 1``.

Robotiq does not publish it. This is what public clients of it agree on (pyRobotiqUR, and the class that
Robotiq's own forum gives): a line feed ends a question, the answer to GET is the name and the number, the one
to SET is ``ack`` alone, and something else is answered by ``?``.
"""

import asyncio
from collections.abc import Callable
from typing import cast

from fakes.robotiq.hand import Hand
from fakes.wire.listening import Listener, TcpPlace

_LONGEST = 256


class UrcapSocket:
    """Serves ``hand`` at ``place`` between :meth:`start` and :meth:`stop`."""

    def __init__(self, hand: Hand, place: TcpPlace, line_feed: bool = False) -> None:
        self.silent = False  # as while the gripper is not connected to the controller
        self._hand, self._end = hand, b"\n" if line_feed else b""
        self._clients: set[_Client] = set()
        self._listener = Listener(lambda: _Client(self._answer, self._clients), (place,))

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens, after :meth:`start`."""
        return self._listener.addresses[0]

    async def start(self) -> None:
        """Listen; ``OSError`` when the address is taken."""
        await self._listener.listen()

    async def stop(self) -> None:
        """Close everything."""
        self._listener.off = True
        self._listener.refuse()
        for client in tuple(self._clients):
            client.abort()
        await self._listener.closed()

    def _answer(self, line: str) -> bytes:
        match line.split():
            case ["GET", name] if (value := self._hand.read(name)) is not None:
                answer = f"{name} {value}\n".encode()
            case ["SET", *pairs] if pairs and len(pairs) % 2 == 0 and self._take(pairs):
                answer = b"ack" + self._end
            case _:
                answer = b"?\n"
        return b"" if self.silent else answer

    def _take(self, pairs: list[str]) -> bool:
        names, numbers = pairs[::2], pairs[1::2]
        known = all(name in self._hand.values for name in names)
        if not known or not all(n.isdecimal() and int(n) <= 255 for n in numbers):
            return False
        self._hand.write({name: int(n) for name, n in zip(names, numbers, strict=True)})
        return True


class _Client(asyncio.Protocol):
    """One connection; several may be open."""

    def __init__(self, answer: Callable[[str], bytes], clients: "set[_Client]") -> None:
        self._answer, self._clients = answer, clients
        self._transport: asyncio.Transport | None = None
        self._rest = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._clients.add(self)

    def data_received(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _LONGEST:
            self.abort()
            return
        for line in lines:
            answer = self._answer(line.decode("ascii", "replace"))
            if answer and self._transport is not None:
                self._transport.write(answer)

    def connection_lost(self, exc: Exception | None) -> None:
        self._clients.discard(self)
        self._transport = None

    def abort(self) -> None:
        """End it without waiting."""
        if self._transport is not None:
            self._transport.abort()
