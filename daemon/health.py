"""Is this process fit to keep running? Loop lag, beats of essential tasks, and systemd's watchdog."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from cell import own_delay
from cell.clock import Clock
from cell.time_histogram import TimeHistogram

log = logging.getLogger("cellward.health")

TOLD_EVERY_S = 60.0  # a busy machine is late many times a minute


@dataclass
class Beats:
    """When each essential task last said that it is alive."""

    clock: Clock
    max_silence_s: float = 2.0
    _last: dict[str, float] = field(default_factory=dict)

    def beat(self, task: str) -> None:
        self._last[task] = self.clock.now()

    def retire(self, task: str) -> None:
        """A task that ended on purpose is no longer expected to beat."""
        self._last.pop(task, None)

    def silent(self) -> list[str]:
        """The tasks that have not beaten lately."""
        now = self.clock.now()
        return [name for name, t in self._last.items() if now - t > self.max_silence_s]


@dataclass
class LoopLag:
    """How late the event loop runs: the delay of a periodic wake-up."""

    clock: Clock
    period_s: float = 0.05
    last_s: float = 0.0
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=1200))
    _ends: deque[float] = field(default_factory=lambda: deque(maxlen=1200))
    _into: TimeHistogram | None = None

    async def watch(self, beats: Beats, warn_s: float) -> None:
        """Measure for ever; the first lag past ``warn_s`` is one log line, those after it are summed up."""
        told_at, count, longest = -TOLD_EVERY_S, 0, 0.0
        try:
            while True:
                due = self.clock.now() + self.period_s
                own_delay.expect(due)
                await self.clock.sleep(self.period_s)
                self.last_s = max(self.clock.now() - due, 0.0)
                own_delay.woken(self.clock.now())
                self.recent.append(self.last_s)
                self._ends.append(due + self.last_s)
                if self._into is not None:
                    self._into.add(self.last_s)
                beats.beat("loop")
                if self.last_s > warn_s:
                    count, longest = count + 1, max(longest, self.last_s)
                if count and due - told_at >= TOLD_EVERY_S:
                    more = f", the longest of {count} times since the last such line" if count > 1 else ""
                    log.warning("the event loop is late: lag %.1f ms%s", 1e3 * longest, more)
                    told_at, count, longest = due, 0, 0.0
        finally:
            own_delay.forget()

    def count_into(self, spread: TimeHistogram | None) -> None:
        """Count every lag from now on in ``spread`` as well; None ends that."""
        self._into = spread

    def longest_since(self, since: float) -> float:
        """The longest lag that ended after ``since``, s."""
        return max(
            (lag for lag, end in zip(self.recent, self._ends, strict=True) if end > since), default=0.0
        )

    def summary(self) -> dict[str, float]:
        """Median, 99th percentile and maximum of the last minute, s."""
        lags = sorted(self.recent) or [0.0]
        return {
            "p50_s": lags[len(lags) // 2],
            "p99_s": lags[min(len(lags) * 99 // 100, len(lags) - 1)],
            "max_s": lags[-1],
        }


async def watchdog(
    beats: Beats, lag: LoopLag, fail_s: float, period_s: float, feed: Callable[[], None]
) -> None:
    """Feed systemd's watchdog while the loop is in time and every essential task beats.

    A lost device is a state, never a reason to be restarted: device tasks beat while they retry.
    """
    withheld = False
    while True:
        silent = beats.silent()
        fit = lag.last_s < fail_s and not silent
        if fit:
            feed()
        if fit == withheld:
            withheld = not fit
            if withheld:
                log.error("watchdog withheld: lag %.3f s, silent tasks %s", lag.last_s, silent or "none")
            else:
                log.info("watchdog fed again")
        await asyncio.sleep(period_s)
