"""What one sender cannot do: two positions in turn on one identifier, and frames far beyond its timer."""

from collections import deque

_PAIRS, _AGREE = 10, 8  # of the latest steps, so many have to tell the same
_LEAST_COUNTS, _BACK = 16, 8  # a step to the other sender is this large, and is taken back to an eighth
_WINDOW_S, _TOO_MANY = 1.0, 2.0  # times as many frames as the timer sends
_STALL_S, _SLOWER = 10.0, 1.1  # the longest silence that is made good; a timer that is slower by a tenth


class TwoSenders:
    """Told of every unwrapped count."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._step = 0
        self._back: deque[bool] = deque(maxlen=_PAIRS)

    def seen(self, count: int) -> bool:
        """Whether the counts go to and fro between two places."""
        before, self._last = self._last, count
        if before is None:
            return False
        step, last = count - before, self._step
        self._step = step
        back = step * last < 0 and min(abs(step), abs(last)) >= max(_LEAST_COUNTS, _BACK * abs(step + last))
        self._back.append(back)
        return sum(self._back) >= _AGREE


class Flood:
    """Told of every frame. Whoever could not read for a while finds at once all that was sent meanwhile: such
    frames count as sent one after the other in the silence before them. A flood is told the later the less it
    is one: of three times the timer's rate after 2 s, of 2.2 times after 10 s."""

    def __init__(self, period_s: float) -> None:
        self._each_s, self._apart_s = period_s / _TOO_MANY, _SLOWER * period_s
        self._sent: float | None = None  # when the latest frame may have been, at the earliest
        # Since when frames count, and up to where they would fill the time at the highest rate allowed.
        self._since = self._filled = 0.0
        self._frames = 0

    def seen(self, t: float) -> float | None:
        """Frames a second, when they are too many; None while they are not."""
        sent = t if self._sent is None else min(max(self._sent + self._apart_s, t - _STALL_S), t)
        if self._sent is None or self._filled <= sent - _WINDOW_S:
            self._filled, self._since, self._frames = sent - _WINDOW_S, sent, 0
        self._sent = sent
        self._filled += self._each_s
        self._frames += 1
        return None if self._filled <= t else self._frames / max(t - self._since, 1e-3)
