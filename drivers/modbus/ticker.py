"""Ticks at an exact period on CLOCK_MONOTONIC, by the kernel's timerfd.

``asyncio.sleep`` wakes up to a millisecond late, as epoll counts whole ones, and would drift.
"""

import asyncio
import ctypes
import os
import time

from cell.errors import error

_NANO = 1_000_000_000
_NONBLOCK, _CLOEXEC, _ABSOLUTE = os.O_NONBLOCK, os.O_CLOEXEC, 1


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("value", _Timespec))


class Ticker:
    """Numbered ticks from :meth:`start` to :meth:`stop`; those that nobody waits for are gone."""

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(period_s * _NANO)
        self._fd: int | None = None
        self._number = 0
        self._waiter: asyncio.Future[int] | None = None

    def start(self) -> None:
        """Begin to tick, one period from now; tick 1 is the first."""
        self._number = 0
        self._fd = fd = _timer(time.monotonic_ns() + self._period_ns, self._period_ns)
        asyncio.get_running_loop().add_reader(fd, self._expired, fd)

    async def wait(self) -> int:
        """The number of the next tick; between two calls numbers are missing for the ticks in between."""
        if self._fd is None:
            raise error("INTERNAL", "somebody waits for a ticker that does not tick")
        self._waiter = asyncio.get_running_loop().create_future()
        return await self._waiter

    def stop(self) -> None:
        """Tick no more."""
        fd, self._fd = self._fd, None
        if fd is not None:
            asyncio.get_running_loop().remove_reader(fd)
            os.close(fd)

    def _expired(self, fd: int) -> None:
        try:
            expirations = int.from_bytes(os.read(fd, 8), "little")
        except BlockingIOError:
            return
        self._number += expirations
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(self._number)


def _timer(first_ns: int, period_ns: int) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    fd: int = libc.timerfd_create(time.CLOCK_MONOTONIC, _NONBLOCK | _CLOEXEC)
    if fd < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    spec = _Itimerspec(_Timespec(*divmod(period_ns, _NANO)), _Timespec(*divmod(first_ns, _NANO)))
    if libc.timerfd_settime(fd, _ABSOLUTE, ctypes.byref(spec), None) != 0:
        number = ctypes.get_errno()
        os.close(fd)
        raise OSError(number, os.strerror(number))
    return fd
