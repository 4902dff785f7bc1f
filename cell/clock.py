"""One time axis: CLOCK_MONOTONIC seconds, and the mapping of foreign clocks onto it."""

import asyncio
import time
from collections import deque
from collections.abc import Sequence
from typing import Protocol

MOST_DRIFT = 3e-4  # between two clocks; quartz is good to 1e-4, and most to a tenth of that
_LEAST_BINS = 5


class Clock(Protocol):
    """Time as the logic sees it; the object twin injects a virtual one."""

    def now(self) -> float:
        """Seconds on the monotonic axis."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Return not earlier than ``seconds`` from now."""
        ...


class MonotonicClock:
    """The real clock. CLOCK_MONOTONIC, so stamps of depthai and of other processes share the axis."""

    def now(self) -> float:
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


class ClockModel:
    """Maps the stamps of a source onto our clock from arrival times alone.

    Delay only ever adds, so the truth lies on the lower envelope of ``arrival - source``. The envelope is
    the minimum over short bins; a line through the bins' minima follows the drift of the source's clock.
    The constant part of the one-way delay cannot be seen from one side: it is in ``time_offset_s``.
    """

    def __init__(self, bin_s: float = 1.0, bins: int = 30, jump_s: float = 0.5) -> None:
        self._bin_s, self._jump_s = bin_s, jump_s
        self._minima: deque[tuple[float, float]] = deque(maxlen=bins)
        self._last_source: float | None = None
        self._origin = 0.0
        self._bin_start = 0.0
        self._line = (0.0, 0.0)
        self.resets = 0

    def observe(self, source: float, arrival: float) -> float:
        """Take one pair of stamps in seconds and return the source's stamp on our axis.

        Never later than ``arrival``. A source that jumps (a reboot) starts the model afresh.
        """
        offset = arrival - source
        jumped = self._last_source is not None and (
            source < self._last_source or abs(offset - self._predict(source)) > self._jump_s
        )
        if self._last_source is None or jumped:
            self.resets += int(jumped)
            self._minima.clear()
            self._origin = source
        self._last_source = source
        if not self._minima or source - self._bin_start >= self._bin_s:
            self._bin_start = source
            self._minima.append((source, offset))
            self._fit()
        elif offset < self._minima[-1][1]:
            self._minima[-1] = (source, offset)
            self._fit()
        return min(source + self._predict(source), arrival)

    def _predict(self, source: float) -> float:
        return self._line[0] + self._line[1] * (source - self._origin)

    def _fit(self) -> None:
        """Line through the minima, shifted down to touch the lowest; the newest bin is still filling.

        A slope that no two clocks have comes of bins in which everything was late, the highest of all: they
        are left out, or the line would put all later stamps too early for as long as they count.
        """
        points = list(self._minima)
        settled = points[:-1]
        slope = 0.0
        while len(settled) >= _LEAST_BINS:
            slope = _slope(settled)
            if abs(slope) <= MOST_DRIFT:
                break
            settled.remove(max(settled, key=lambda point: point[1]))
            slope = 0.0
        level = min(o - slope * (s - self._origin) for s, o in points)
        self._line = (level, slope)


def _slope(points: Sequence[tuple[float, float]]) -> float:
    """Of the least-squares line through points (x, y)."""
    n = len(points)
    mx, my = sum(x for x, _ in points) / n, sum(y for _, y in points) / n
    return sum((x - mx) * (y - my) for x, y in points) / sum((x - mx) ** 2 for x, _ in points)
