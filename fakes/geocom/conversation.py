"""One client of a station: its lines, answered in order, with what goes wrong on the way."""

import asyncio
from dataclasses import dataclass, field

from fakes.faults.vocabulary import Link, LinkFaults
from fakes.geocom.codes import OF_THE_LINE
from fakes.geocom.instrument import Instrument
from fakes.geocom.text import ABORT_LINE, Receiver, RefusedLine, parse, reply

_MOST_WAITING = 256


@dataclass
class LineFaults:
    """How answers misbehave on every wire of one station."""

    link: LinkFaults = field(default_factory=LinkFaults)
    silent: bool = False
    duplicate: bool = False
    lose: int = 0  # so many answers are never sent


class Conversation:
    """Feed it with :meth:`received`; it lives until :meth:`close`."""

    def __init__(self, instrument: Instrument, link: Link, faults: LineFaults) -> None:
        self._instrument, self._link, self._faults = instrument, link, faults
        self._receiver = Receiver()
        self._lines: asyncio.Queue[bytes] = asyncio.Queue(_MOST_WAITING)
        self._task = asyncio.get_running_loop().create_task(self._serve(), name="twin's GeoCOM client")

    def received(self, data: bytes) -> None:
        """Bytes of the client; an abort overtakes what waits."""
        for line in self._receiver.feed(data):
            if line.strip() == ABORT_LINE:
                self._instrument.abort()
                self._send(b"?\r\n")
            elif not self._lines.full():
                self._lines.put_nowait(line)

    def close(self) -> None:
        """Forget what waits."""
        self._task.cancel()

    async def _serve(self) -> None:
        while True:
            line = await self._lines.get()
            answer = await self._answer(line)
            if self._faults.lose > 0:
                self._faults.lose -= 1
            else:
                self._send(answer)

    async def _answer(self, line: bytes) -> bytes:
        digits = self._instrument.settings.digits
        try:
            request = parse(line)
        except RefusedLine as refusal:
            return reply(refusal.transaction, 0, (), digits, False, refusal.code)
        code, values = await self._instrument.call(request.rpc, request.parameters)
        digits = self._instrument.settings.digits
        if code in OF_THE_LINE:
            return reply(request.transaction, 0, (), digits, request.checked, code)
        return reply(request.transaction, code, values, digits, request.checked)

    def _send(self, data: bytes) -> None:
        if not self._faults.silent:
            self._link.send(data * 2 if self._faults.duplicate else data)
