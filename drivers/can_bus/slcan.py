"""python-can's bus on a serial adapter, corrected for a long life.

The original reads byte by byte, ends its reader for good at one malformed line, hands out frames whose data
were cut off, and keeps the file open when the adapter was pulled out. Its codec is used as it is.
"""

import re
import select
from collections import deque
from contextlib import suppress

import can
from can.interfaces.slcan import slcanBus

from cell.wire_recording.tap import tap
from drivers.can_bus.address import BusAddress
from drivers.can_bus.arrivals import Arrivals

_LONGEST_LINE = 64
_FRAME = re.compile(r"[tTrR]")
_FLAGS = re.compile(r"F([0-9A-Fa-f]{2})")
_REFUSED = "\a"


class SerialBus(slcanBus):
    """``recv`` raises ``CanOperationError`` once when the adapter is gone; never sleeps."""

    def __init__(self, address: BusAddress, timeout: float) -> None:
        self.malformed = 0
        self.flags: int | None = None  # the adapter's answer to :meth:`ask_flags`
        self._raw = bytearray()
        self._lines: deque[tuple[float, str]] = deque()
        self._arrivals: Arrivals | None = None
        self._tap = tap("slcan", address.channel)
        super().__init__(
            address.channel,
            tty_baudrate=address.baudrate,
            bitrate=address.bit_rate,
            sleep_after_open=0.0,
            timeout=0.0,
        )
        self.serialPortOrig.write_timeout = timeout
        self._arrivals = Arrivals(self.serialPortOrig.fileno())

    def fileno(self) -> int:
        """Readable when something has arrived, or the line has ended."""
        return -1 if self._arrivals is None else self._arrivals.fd

    def ask_flags(self) -> None:
        """Ask for the adapter's status flags; the answer comes among the frames."""
        self.flags = None
        self._write("F")

    def _write(self, string: str) -> None:
        self._tap.sent(string.encode() + b"\r")
        super()._write(string)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        while self._lines or self._fill(timeout):
            t, line = self._lines.popleft()
            if _FRAME.match(line):
                if (message := self._decoded(line)) is not None:
                    message.timestamp = t  # monotonic: when its last byte was there
                    return message, False
                self.malformed += 1
            elif found := _FLAGS.fullmatch(line):
                self.flags = int(found[1], 16)
        return None, False

    def _decoded(self, line: str) -> can.Message | None:
        """The frame, or None when the line is not exactly one; a time stamp of four digits may follow."""
        head = 5 if line[0] in "tr" else 10
        try:
            self._queue.put_nowait(line)
            message, _ = super()._recv_internal(0)
        except (ValueError, LookupError):
            return None
        if message is None or message.dlc > 8:
            return None
        digits = 0 if message.is_remote_frame else 2 * message.dlc
        return message if len(line) - head - digits in (0, 4) else None

    def _fill(self, timeout: float | None) -> bool:
        """Take what has arrived; whether there are whole lines."""
        arrivals = self._arrivals
        if arrivals is None or (timeout != 0 and not select.select([arrivals.fd], [], [], timeout)[0]):
            return False
        try:
            chunks = arrivals.take()
        except OSError as exc:
            raise can.CanOperationError(f"the adapter is gone ({exc})") from exc
        for t, chunk in chunks:
            self._tap.received(chunk, t)
            self._raw += chunk
            *lines, rest = self._raw.split(b"\r")
            if len(rest) > _LONGEST_LINE:
                self.malformed += 1
                rest = rest[:0]
            self._raw = bytearray(rest)
            self._lines += [(t, line.decode("ascii", "replace").lstrip(_REFUSED)) for line in lines if line]
        return bool(self._lines)

    def shutdown(self) -> None:
        """Close channel and file; the channel of an adapter that is gone needs no closing."""
        if self._arrivals is not None:
            self._arrivals.close()
        with suppress(can.CanError, OSError):
            super().shutdown()
        with suppress(OSError):
            self.serialPortOrig.close()
        self._tap.closed()
