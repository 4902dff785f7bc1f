"""The distance meter of a station: one distance when asked, or one after the other."""

import asyncio
from collections.abc import Callable

from fakes.world.tracker.tracker import Reading, Tracker

STOP, DISTANCE, TRACK, CLEAR, SIGNAL, RESTART, RAPID_TRACK, REFLECTORLESS_TRACK = 0, 1, 2, 3, 4, 6, 8, 10
PROGRAMS = (STOP, DISTANCE, TRACK, CLEAR, SIGNAL, RESTART, RAPID_TRACK, REFLECTORLESS_TRACK)
_TRACKS = (TRACK, RAPID_TRACK, REFLECTORLESS_TRACK)
_SHORTEST_WAIT_S = 0.001


class Edm:
    """Readings of ``tracker`` as a distance meter gives them; ``now`` is the twin's clock."""

    def __init__(self, tracker: Tracker, now: Callable[[], float]) -> None:
        self._tracker, self._now = tracker, now
        self._program, self._since = CLEAR, 0.0
        self._kept: Reading | None = None
        self._frozen: Reading | None = None

    @property
    def tracks(self) -> bool:
        """Whether it measures all the time."""
        return self._program in _TRACKS

    def start(self, program: int) -> None:
        """Begin, stop or clear; the last distance stays after a stop and only then."""
        self._kept = self.newest() if program == STOP else None
        self._program, self._since = DISTANCE if program == RESTART else program, self._now()

    def newest(self) -> Reading | None:
        """The newest distance that is finished, or the failure to measure one; None while there is none."""
        due = self._due()
        if due is not None and (self._kept is None or self._kept.t < due):
            self._kept = self._tracker.read(due)
        return self._frozen or self._kept

    async def wait(self, wait_s: float) -> Reading | None:
        """The same, waiting up to ``wait_s`` for the first."""
        give_up = self._now() + wait_s
        while (reading := self.newest()) is None and self._program not in (STOP, CLEAR):
            left = min(give_up, self._next()) - self._now()
            if self._now() >= give_up:
                return None
            await asyncio.sleep(max(left, _SHORTEST_WAIT_S))
        return reading

    def freeze(self, on: bool) -> None:
        """Give the newest distance for ever, or live again."""
        self._frozen = None
        self._frozen = self.newest() if on else None

    def _due(self) -> float | None:
        """When the newest distance was finished that has been begun since the start."""
        now, first = self._now(), self._next()
        if self._program in (STOP, CLEAR) or now < first:
            return None
        return max(self._tracker.last_tick(now), first) if self.tracks else first

    def _next(self) -> float:
        """When the first distance since the start is finished."""
        return self._since + self._tracker.truth.measure_s
