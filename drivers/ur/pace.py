"""When set-points are due: one a cycle of the controller, about half way between two of its cycles.

The controller takes what lies there at the beginning of a cycle. Set-points at the same rate but near that
moment come now before it and now after it: a cycle finds the old one, the next leaps over two, and the tool
shakes for as long as both clocks stand so. Half a cycle off, a set-point may be late or early by as much.
"""

from math import ceil, floor

# Of a cycle, after the stamp of a state. A state is seen some tenths of a millisecond late and a set-point
# takes as long, so it arrives near the middle. ``python -m bench.setpoints`` prints what other places cost.
SENT_AT = 0.35


class Pace:
    """Times in s of CLOCK_MONOTONIC, as the stamps of the controller's states are."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.due = 0.0
        self._cycle: float | None = None

    def begin(self, now: float) -> None:
        """The first set-point is due now."""
        self.due = now

    def keep_to(self, cycle: float) -> None:
        """The controller began a cycle then, and does so every ``period_s``; the newest is the truest."""
        self._cycle = cycle

    def take(self, now: float) -> float:
        """The instant of the set-point to send ``now``: when it was due, or when the latest of those was that
        are due by now. The others are dropped, not caught up."""
        period = self.period_s
        slot = self.due + period * max(floor((now - self.due) / period), 0)
        self.due = slot + period
        if self._cycle is not None:
            # The next one in step; half a period away at least, where the first or a shift is out of step.
            sent = self._cycle + SENT_AT * period
            self.due = sent + period * ceil((slot + 0.5 * period - sent) / period)
        return slot
