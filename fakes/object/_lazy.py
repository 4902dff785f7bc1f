"""A stream that makes its samples when somebody looks.

A source at 100 Hz costs nothing while nobody reads it. As soon as a listener subscribes the loop keeps the
stream filled, sample by sample; otherwise a reader gets exactly those that would have been there by now.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from cell.clock import Clock
from cell.samples import Quality, Sample, Stream
from fakes.object.loop import Ticks, VirtualTimeLoop

T = TypeVar("T")

BACKFILL = 200  # a reader after a long pause gets so many samples, not the whole pause


class LazyStream(Stream[T]):
    """``make(t, tick)`` gives the value at a tick; a sample can be read ``delay_s`` after its ``t``."""

    def __init__(
        self,
        name: str,
        clock: Clock,
        period_s: float,
        make: Callable[[float, int], T],
        dt: float,
        delay_s: float = 0.0,
        keep: int = 4096,
        backfill: int = BACKFILL,
    ) -> None:
        super().__init__(name, clock, keep)
        self.period_s = period_s
        self.quality = Quality.GOOD  # of the samples from now on
        self._make, self._dt, self._delay_s, self._backfill = make, dt, delay_s, backfill
        self._origin = 0.0
        self._tick = 0
        self._seq = 0
        self._running = False
        self._silent = False
        self._filling = False
        self._ticks: Ticks | None = None

    # -- the source's side

    def start(self, silent: bool = False) -> None:
        """A new connection: a new epoch, first sample now unless the source is silent."""
        self.new_epoch()
        self._origin, self._tick = self.clock.now(), 0
        self._running, self._silent = True, silent
        self._keep_filled()

    def stop(self) -> None:
        """The connection ended; what was read stays readable."""
        self.fill()
        self._running = False
        self._end_ticks()

    def silence(self) -> None:
        """No samples from now on, though the connection stands."""
        self.fill()
        self._silent = True
        self._end_ticks()

    def resume(self) -> None:
        """Samples again; those of the silence are a gap."""
        if self._silent:
            self._silent = False
            missed = max(self._due() - self._tick, 0)
            self._tick, self._seq = self._tick + missed, self._seq + missed
            self._keep_filled()

    def skip(self, count: int) -> None:
        """Lose the next ``count`` samples; the numbering shows it."""
        self.fill()
        self._tick += count
        self._seq += count

    def leave_out(self, before: float) -> None:
        """Do not make samples of before this time that nobody has looked at, as far as they are due."""
        if self._listeners or self._silent or not self._running:
            return
        first = min(int((before - self._origin) / self.period_s), self._due())
        if first > self._tick:
            self._tick = first
            self._newest_t = self.time_of(first - 1)  # not asked for is no gap

    def fill(self) -> None:
        """Make every sample that is due."""
        if self._filling or self._silent or not self._running:
            return
        due = self._due()
        if self._tick >= due:
            return
        self._filling = True
        try:
            if not self._listeners and self._tick < due - self._backfill:
                self._tick = due - self._backfill
                self._newest_t = self.time_of(self._tick - 1)  # not asked for is no gap
            while self._tick < due:
                t = self._origin + self._tick * self.period_s
                self.push(Sample(self._make(t, self._tick), t, self._dt, self._seq, self.quality))
                self._tick, self._seq = self._tick + 1, self._seq + 1
        finally:
            self._filling = False

    def _due(self) -> int:
        """How many ticks are over by now."""
        age = self.clock.now() - self._delay_s - self._origin
        return int(age / self.period_s + 1e-6) + 1 if age >= -1e-9 else 0

    def time_of(self, tick: int) -> float:
        """The stamp of a tick of this connection."""
        return self._origin + tick * self.period_s

    # -- the reader's side

    def subscribe(self, listener: Callable[[Sample[T]], None]) -> Callable[[], None]:
        self.fill()
        unsubscribe = super().subscribe(listener)
        self._keep_filled()

        def end() -> None:
            unsubscribe()
            if not self._listeners:
                self._end_ticks()

        return end

    def last(self) -> Sample[T] | None:
        self.fill()
        return super().last()

    def latest(self, max_age: float) -> Sample[T]:
        self.fill()
        return super().latest(max_age)

    def between(self, t0: float, t1: float) -> list[Sample[T]]:
        self.fill()
        return super().between(t0, t1)

    def at(self, t: float, interpolate: Callable[[T, T, float], T], max_bracket: float = 0.1) -> T:
        self.fill()
        return super().at(t, interpolate, max_bracket)

    def _keep_filled(self) -> None:
        if self._ticks is None and self._is_awaited:
            loop = asyncio.get_running_loop()
            if not isinstance(loop, VirtualTimeLoop):
                raise TypeError(f"{self.name} lives on virtual time, and this loop has none")
            self._ticks = loop.call_repeatedly(self._next_due(loop), partial(self._on_tick, loop))

    def _on_tick(self, loop: VirtualTimeLoop) -> float | None:
        ticks = self._ticks
        self.fill()
        return self._next_due(loop) if self._ticks is ticks and self._is_awaited else None

    @property
    def _is_awaited(self) -> bool:
        return self._running and not self._silent and bool(self._listeners)

    def _next_due(self, loop: VirtualTimeLoop) -> float:
        """The loop's time of the next sample that a listener waits for."""
        wait = self._origin + self._tick * self.period_s + self._delay_s - self.clock.now()
        return loop.time() + (wait if wait > 0.0 else 0.0)

    def _end_ticks(self) -> None:
        if self._ticks is not None:
            self._ticks.cancel()
            self._ticks = None
