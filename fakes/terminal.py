"""The device's end of a serial line: a pseudo-terminal under a name that a client opens."""

import asyncio
import os
import termios
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from fakes.faults import Link, LinkFaults

_CHUNK = 4096
_BAUD = {
    getattr(termios, f"B{rate}"): rate
    for rate in (300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
}


class PseudoTerminal:
    """``path`` is a symbolic link to the terminal while it is open; ``take`` gets what the client wrote."""

    def __init__(self, path: Path, faults: LinkFaults, take: Callable[[bytes], None]) -> None:
        self.path, self._faults, self._take = path, faults, take
        self._ours = self._theirs = -1
        self.link: Link | None = None

    def open(self) -> None:
        """Make the terminal and its name."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.link = Link(_Writer(self._ours), self._faults)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._theirs))
        asyncio.get_running_loop().add_reader(self._ours, self._readable)

    def close(self) -> None:
        """Remove both; a client that has it open sees its line hung up. Harmless when not open."""
        if self.link is None:
            return
        asyncio.get_running_loop().remove_reader(self._ours)
        self.link.close()
        self.link = None
        self.path.unlink(missing_ok=True)
        os.close(self._ours)
        os.close(self._theirs)

    def send(self, data: bytes) -> None:
        """Put bytes on the line; nothing while it is not open."""
        if self.link is not None:
            self.link.send(data)

    @property
    def baudrate(self) -> int:
        """The speed that the client has set; it changes nothing here."""
        return _BAUD.get(termios.tcgetattr(self._theirs)[4], 115200)

    def _readable(self) -> None:
        with suppress(BlockingIOError):
            data = os.read(self._ours, _CHUNK)
            if not self._faults.half_open:
                self._take(data)


class _Writer(asyncio.Transport):
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
