"""A pseudo-terminal whose far end a client opens like a serial port."""

import asyncio
import os
import termios
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from fakes.faults.vocabulary import Link, LinkFaults

_DEFAULT_BAUD = 115200
_BAUD = {
    getattr(termios, f"B{rate}"): rate
    for rate in (300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
}
MOST_READ = 4096


class PseudoTerminal:
    """Our end of the line: ``received`` gets its bytes. ``path`` is a symbolic link to the other end."""

    def __init__(self, path: Path, faults: LinkFaults, received: Callable[[bytes], None]) -> None:
        self.path = path
        self._faults, self._received = faults, received
        self._ours: int | None = None
        self._theirs: int | None = None
        self._link: Link | None = None

    @property
    def link(self) -> Link | None:
        """What sends; None while the line is closed."""
        return self._link

    @property
    def baudrate(self) -> int:
        """The speed that the client has set; it changes nothing here."""
        if self._theirs is None:
            return _DEFAULT_BAUD
        return _BAUD.get(termios.tcgetattr(self._theirs)[4], _DEFAULT_BAUD)

    def open(self) -> Link:
        """Make the terminal and its link."""
        ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(ours, False)
        self._ours, self._link = ours, Link(TerminalTransport(ours), self._faults)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._theirs))
        asyncio.get_running_loop().add_reader(ours, self._readable, ours)
        return self._link

    def close(self) -> None:
        """Remove the link and the terminal."""
        if self._ours is None or self._theirs is None or self._link is None:
            return
        asyncio.get_running_loop().remove_reader(self._ours)
        self._link.close()
        self.path.unlink(missing_ok=True)
        os.close(self._ours)
        os.close(self._theirs)
        self._ours = self._theirs = self._link = None

    def send(self, data: bytes) -> None:
        """Put bytes on the line; nothing while it is closed."""
        if self._link is not None:
            self._link.send(data)

    def _readable(self, ours: int) -> None:
        with suppress(BlockingIOError):
            data = os.read(ours, MOST_READ)
            if not self._faults.half_open:
                self._received(data)


class TerminalTransport(asyncio.Transport):
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
