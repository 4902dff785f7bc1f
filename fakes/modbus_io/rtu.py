"""Modbus RTU on a pseudo-terminal: frames end with a silence of 3.5 characters and are checked by a CRC.

A pseudo-terminal has no parity and no speed of its own; the speed that the client sets gives the silence.
"""

import asyncio
import os
import termios
import tty
from contextlib import suppress
from pathlib import Path

from fakes.faults import Link
from fakes.modbus_io.service import Service

SMALLEST_FRAME, LARGEST_FRAME = 4, 256
BROADCAST = 0
_BITS_PER_CHARACTER, _CHARACTERS, _SHORTEST_SILENCE_S = 11, 3.5, 0.00175
_BAUD = {
    getattr(termios, f"B{rate}"): rate
    for rate in (300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
}


def crc16(data: bytes) -> int:
    """The CRC of Modbus RTU: reflected polynomial 0xA001, start 0xFFFF; sent low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


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
        self._ours: int | None = None
        self._theirs: int | None = None
        self._link: Link | None = None
        self._buffer = bytearray()
        self._silence: asyncio.TimerHandle | None = None
        self._pending: set[asyncio.TimerHandle] = set()
        self.powered = True

    def open(self) -> None:
        """Make the terminal and its link."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self._link = Link(_Terminal(self._ours), self._service.faults.link)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._theirs))
        asyncio.get_running_loop().add_reader(self._ours, self._readable)

    def close(self) -> None:
        """Remove the link and the terminal."""
        if self._ours is None or self._theirs is None or self._link is None:
            return
        asyncio.get_running_loop().remove_reader(self._ours)
        self.mute()
        self._link.close()
        self.path.unlink(missing_ok=True)
        os.close(self._ours)
        os.close(self._theirs)
        self._ours = self._theirs = self._link = None

    def send(self, data: bytes) -> None:
        """Put bytes on the line."""
        if self._link is not None and self.powered:
            self._link.send(data)

    def mute(self) -> None:
        """Forget what was asked, as at a loss of power."""
        for timer in (self._silence, *self._pending):
            if timer is not None:
                timer.cancel()
        self._silence = None
        self._pending.clear()
        self._buffer.clear()

    def _readable(self) -> None:
        assert self._ours is not None
        assert self._theirs is not None
        with suppress(BlockingIOError):
            data = os.read(self._ours, 4096)
            if self._service.faults.link.half_open or not self.powered:
                return
            # One byte more than a frame may have is enough to know that it is none.
            self._buffer += data[: LARGEST_FRAME + 1 - len(self._buffer)]
            if self._silence is not None:
                self._silence.cancel()
            baud = _BAUD.get(termios.tcgetattr(self._theirs)[4], 115200)
            loop = asyncio.get_running_loop()
            self._silence = loop.call_later(silence_s(baud), self._frame_ended)

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
            if unit != BROADCAST and self._link is not None:
                self._service.send(self._link, frame(unit, reply))

        timer = self._service.later(answer)
        self._pending.add(timer)


class _Terminal(asyncio.Transport):
    """Writes to a terminal; what it does not take is lost, as on a line with nobody at its end."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor: int | None = descriptor

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if self._descriptor is not None:
            with suppress(BlockingIOError):
                os.write(self._descriptor, data)

    def is_closing(self) -> bool:
        return self._descriptor is None

    def close(self) -> None:
        self._descriptor = None

    abort = close

    def get_write_buffer_size(self) -> int:
        return 0
