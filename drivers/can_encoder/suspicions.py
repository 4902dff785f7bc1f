"""What one sender cannot do: two positions in turn on one identifier, and frames far beyond its timer."""

from collections import deque

_PAIRS, _AGREE = 10, 8  # of the latest steps, so many have to tell the same
_LEAST_COUNTS, _BACK = 16, 8  # a step to the other sender is this large, and is taken back to an eighth
_WINDOW_S, _TOO_MANY = 1.0, 2.0  # times as many frames as the timer sends


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
    """Told of every frame."""

    def __init__(self, period_s: float) -> None:
        self._most = round(_TOO_MANY * _WINDOW_S / period_s) + 1
        self._heard: deque[float] = deque(maxlen=self._most)

    def seen(self, t: float) -> float | None:
        """Frames a second, when they are too many; None while they are not."""
        self._heard.append(t)
        spent = t - self._heard[0]
        if len(self._heard) < self._most or spent > _WINDOW_S:
            return None
        return (self._most - 1) / max(spent, 1e-3)
