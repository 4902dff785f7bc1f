"""When bytes arrived at a line that stamps nothing: a thread that only waits, looks at the clock and reads.

The loop may be at work for tens of milliseconds, and a count that is stamped so late is a belt in the wrong
place. The thread knows nothing of frames, so no malformed line can end it, and it ends itself at the first
failure of the line.
"""

import os
import select
import threading
import time
from collections import deque
from contextlib import suppress

from cell.priority import SETPOINTS, real_time

_CHUNK = 4096
_JOIN_S = 1.0


class Arrivals:
    """``take`` gives what has arrived on ``fd``; :attr:`fd` is readable while there is something."""

    def __init__(self, fd: int) -> None:
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._line, self._stop = fd, os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._chunks: deque[tuple[float, bytes]] = deque()
        self._gone: str | None = None
        self._thread = threading.Thread(target=self._read, name="arrivals", daemon=True)
        self._thread.start()

    def take(self) -> list[tuple[float, bytes]]:
        """Monotonic time (s) and bytes of each read since; ``OSError`` when the line is gone and empty."""
        with suppress(BlockingIOError):
            os.eventfd_read(self.fd)
        found = []
        while self._chunks:
            found.append(self._chunks.popleft())
        if not found and self._gone is not None:
            raise OSError(self._gone)
        if self._gone is not None:
            os.eventfd_write(self.fd, 1)  # there is one more thing to say
        return found

    def close(self) -> None:
        """End the thread; the line stays open."""
        if self._stop < 0:
            return
        os.eventfd_write(self._stop, 1)
        self._thread.join(_JOIN_S)
        if not self._thread.is_alive():
            os.close(self.fd)
            os.close(self._stop)
            self._stop = -1

    def _read(self) -> None:
        look = select.poll()
        look.register(self._line, select.POLLIN)
        look.register(self._stop, select.POLLIN)
        with real_time(SETPOINTS):
            while self._gone is None:
                events = dict(look.poll())
                if self._stop in events:
                    return
                t = time.monotonic()
                try:
                    chunk = os.read(self._line, _CHUNK)
                except BlockingIOError:
                    continue
                except OSError as exc:
                    self._gone = exc.strerror or str(exc)
                else:
                    if chunk:
                        self._chunks.append((t, chunk))
                    elif events[self._line] & (select.POLLHUP | select.POLLERR | select.POLLNVAL):
                        self._gone = "its line was hung up"
                os.eventfd_write(self.fd, 1)
