"""Wakes the loop at absolute deadlines by a timerfd: epoll's own timeout is rounded to milliseconds."""

import asyncio
import ctypes
import os
import time
from collections.abc import Callable

_CLOCK_MONOTONIC = 1
_TFD_NONBLOCK = os.O_NONBLOCK
_TFD_CLOEXEC = os.O_CLOEXEC
_TFD_TIMER_ABSTIME = 1
MOST_CATCH_UP = 100  # cycles made up for after a stall; older ones are lost, as on an overloaded controller

LATE_S = 0.01


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("value", _Timespec))


def _timespec(seconds: float) -> _Timespec:
    whole = int(seconds)
    return _Timespec(whole, round((seconds - whole) * 1e9))


class Ticker:
    """Calls ``cycle(t)`` for every ``t = start + k / rate``, in order, each at or soon after its time."""

    def __init__(
        self,
        rate: float,
        cycle: Callable[[float], None],
        now: Callable[[], float],
        stood_still: Callable[[float, float], None] = lambda seconds, now: None,
    ) -> None:
        """``stood_still``: told before the next cycle how long this process got no core, and the time now."""
        self._period, self._cycle, self._now, self._stood_still = 1.0 / rate, cycle, now, stood_still
        self._origin, self._count = 0.0, 0
        self._fd = -1
        self.cycles = self.lost = 0
        # Of the lost cycles, those for which this process was at work and not without a core.
        self.overrun = 0
        self._worked = 0.0

    def start(self) -> None:
        """Begin with the running loop."""
        libc = ctypes.CDLL(None, use_errno=True)
        self._fd = libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_NONBLOCK | _TFD_CLOEXEC)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._origin, self._count = self._now(), 1
        spec = _Itimerspec(_timespec(self._period), _timespec(self._due))
        if libc.timerfd_settime(self._fd, _TFD_TIMER_ABSTIME, ctypes.byref(spec), None) != 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
        asyncio.get_running_loop().add_reader(self._fd, self._wake)

    def stop(self) -> None:
        """End; harmless when not started."""
        if self._fd >= 0:
            asyncio.get_running_loop().remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    @property
    def _due(self) -> float:
        return self._origin + self._count * self._period

    def catch_up(self) -> float:
        """Call the cycles that are due, and give the time.

        After a stall the loop may come to a question first: who answers for now has to know what the cycles
        of the past do, or it takes back later what it has answered.
        """
        now = self._now()
        if self._fd >= 0 and now >= self._due:
            self._run(now)
        return now

    def _wake(self) -> None:
        os.read(self._fd, 8)
        self._run(self._now())

    def _run(self, now: float) -> None:
        if now - self._due > LATE_S:
            self._stood_still(now - self._due, now)
        behind = int((now - self._due) / self._period)
        if behind > MOST_CATCH_UP:
            self.lost += behind
            self._count += behind
            if time.thread_time() - self._worked > 0.5 * behind * self._period:
                self.overrun += behind
        while self._due <= now and self._fd >= 0:
            due = self._due
            self._count += 1
            self.cycles += 1
            self._cycle(due)
        self._worked = time.thread_time()
