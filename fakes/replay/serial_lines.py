"""A serial line of a recording: a pseudo-terminal that knows when a driver opens it, and when it lets go."""

import asyncio
import os
import select
import tty
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

from cell.errors import error, present
from fakes.wire.terminal import MOST_READ, TerminalTransport

LOOK_S = 0.005  # between looks whether somebody has opened it


def serial_line(protocol: str, peer: str) -> Path | None:
    """The path of the line that a connection was made on; None for what is none."""
    if protocol == "slcan":
        return Path(peer)
    parts = urlsplit(peer)
    return (
        Path(parts.path) if (protocol, parts.scheme) in {("modbus", "rtu"), ("tracker", "serial")} else None
    )


class PlayedLine:
    """``place`` is a symbolic link to the end that a driver opens. Each opening is a connection of its own,
    with a protocol that ``made`` makes, and has a terminal of its own: of one alone it would not be seen that
    it was closed and opened again at once."""

    def __init__(self, place: Path, made: Callable[[], asyncio.Protocol]) -> None:
        self._place, self._made = place, made
        self._offered: int | None = None  # our end of the terminal that nobody has opened yet
        self._look: asyncio.TimerHandle | None = None
        self._open: dict[int, tuple[asyncio.Protocol, TerminalTransport]] = {}

    def open(self) -> None:
        """``ARGUMENT_INVALID`` where something else has the path."""
        if os.path.lexists(self._place):  # also a link that leads nowhere: an adapter that is unplugged
            raise error(
                "ARGUMENT_INVALID",
                f"the recording has the serial line {self._place}, which is there: unplug it, or give the"
                " player a folder for lines, and the driver the path in it",
            )
        self._offer()

    def close(self) -> None:
        """Remove the link and the terminals; harmless before :meth:`open`."""
        if self._offered is None:
            return
        if self._look is not None:
            self._look.cancel()
        self._place.unlink(missing_ok=True)
        for ours in tuple(self._open):
            self._let_go(ours)
        os.close(self._offered)
        self._offered = None

    def _offer(self) -> None:
        self._offered, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(self._offered, False)
        fresh = self._place.with_name(f"{self._place.name}.fresh")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(theirs))
        fresh.replace(self._place)
        os.close(theirs)  # from here on it is hung up until a driver opens it
        self._look_for_driver()

    def _look_for_driver(self) -> None:
        ours = present(self._offered, "terminal that is offered")
        if _hung_up(ours):
            self._look = asyncio.get_running_loop().call_later(LOOK_S, self._look_for_driver)
            return
        self._open[ours] = made, transport = self._made(), TerminalTransport(ours)
        asyncio.get_running_loop().add_reader(ours, self._readable, ours, made)
        made.connection_made(transport)
        self._offer()

    def _readable(self, ours: int, made: asyncio.Protocol) -> None:
        try:
            data = os.read(ours, MOST_READ)
        except BlockingIOError:
            return
        except OSError:  # the driver has closed it
            self._let_go(ours)
            return
        made.data_received(data)

    def _let_go(self, ours: int) -> None:
        made, transport = self._open.pop(ours)
        asyncio.get_running_loop().remove_reader(ours)
        transport.close()
        os.close(ours)
        made.connection_lost(None)


def _hung_up(ours: int) -> bool:
    look = select.poll()
    look.register(ours, 0)
    return any(events & select.POLLHUP for _, events in look.poll(0))
