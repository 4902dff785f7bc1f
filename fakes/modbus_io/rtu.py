"""Modbus RTU on a pseudo-terminal: frames end with a silence of 3.5 characters and are checked by a CRC.

A pseudo-terminal has no parity and no speed of its own; the speed that the client sets gives the silence.
"""

import asyncio
from pathlib import Path

from fakes.modbus_io.service import Service
from fakes.wire.crc import crc16 as reflected_crc16
from fakes.wire.terminal import PseudoTerminal

SMALLEST_FRAME, LARGEST_FRAME = 4, 256
BROADCAST = 0
_BITS_PER_CHARACTER, _CHARACTERS, _SHORTEST_SILENCE_S = 11, 3.5, 0.00175


def crc16(data: bytes) -> int:
    """The CRC of Modbus RTU: it starts from 0xFFFF, and is sent low byte first."""
    return reflected_crc16(data, 0xFFFF)


def frame(unit: int, pdu: bytes) -> bytes:
    """A whole frame."""
    body = bytes([unit]) + pdu
    return body + crc16(body).to_bytes(2, "little")


def parse(data: bytes) -> tuple[int, bytes] | None:
    """Unit and PDU of a good frame; None for anything else, which a slave ignores."""
    good = SMALLEST_FRAME <= len(data) <= LARGEST_FRAME and crc16(data) == 0
    return (data[0], data[1:-2]) if good else None


def silence_s(baud: int) -> float:
    """The silence that ends a frame; fixed above 19200 baud, as the standard has it."""
    if baud > 19200:
        return _SHORTEST_SILENCE_S
    return _CHARACTERS * _BITS_PER_CHARACTER / baud


class RtuLine:
    """The slave's end of the line. ``link`` is a symbolic link to the terminal that a client opens."""

    def __init__(self, service: Service, link: Path) -> None:
        self._service, self.path = service, link
        self._terminal = PseudoTerminal(link, service.faults.link, self._received)
        self._buffer = bytearray()
        self._silence: asyncio.TimerHandle | None = None
        self._pending: set[asyncio.TimerHandle] = set()
        self.powered = True

    def open(self) -> None:
        """Make the terminal and its link."""
        self._terminal.open()

    def close(self) -> None:
        """Remove the link and the terminal."""
        self.mute()
        self._terminal.close()

    def send(self, data: bytes) -> None:
        """Put bytes on the line."""
        if self.powered:
            self._terminal.send(data)

    def mute(self) -> None:
        """Forget what was asked, as at a loss of power."""
        for timer in (self._silence, *self._pending):
            if timer is not None:
                timer.cancel()
        self._silence = None
        self._pending.clear()
        self._buffer.clear()

    def _received(self, data: bytes) -> None:
        if not self.powered:
            return
        # One byte more than a frame may have is enough to know that it is none.
        self._buffer += data[: LARGEST_FRAME + 1 - len(self._buffer)]
        if self._silence is not None:
            self._silence.cancel()
        loop = asyncio.get_running_loop()
        self._silence = loop.call_later(silence_s(self._terminal.baudrate), self._frame_ended)

    def _frame_ended(self) -> None:
        self._silence = None
        request = parse(bytes(self._buffer))
        self._buffer.clear()
        if request is None:
            return

        def answer() -> None:
            self._pending.discard(timer)
            unit, pdu = request
            reply = self._service.reply(pdu)
            if unit != BROADCAST and self._terminal.link is not None:
                self._service.send(self._terminal.link, frame(unit, reply))

        timer = self._service.later(answer)
        self._pending.add(timer)
