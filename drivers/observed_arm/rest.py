"""Whether an arm rests, as its joints show it."""

from collections import deque

import numpy as np

from cell.poses import Array

_HELD = 0.5  # the least share of the polls of a window that must have come


class RestWatch:
    """Joints within ``spread`` of each other over ``window_s``; a window with holes decides nothing."""

    def __init__(self, window_s: float, spread: float, period_s: float) -> None:
        self._window_s, self._spread = window_s, spread
        self._least = max(2.0, _HELD * window_s / period_s)
        self._seen: deque[tuple[float, Array]] = deque()

    def begin(self) -> None:
        """A new epoch: what the arm did before is not known."""
        self._seen.clear()

    def take(self, t: float, q: Array, moving: bool) -> bool:
        """One more poll at ``t`` (s); True when the arm has rested for the whole window by then."""
        if moving:
            self._seen.clear()
            return False
        self._seen.append((t, q))
        while len(self._seen) > 1 and self._seen[1][0] <= t - self._window_s:
            self._seen.popleft()
        if self._seen[0][0] > t - self._window_s or len(self._seen) < self._least:
            return False
        return bool(np.max(np.ptp([joints for _, joints in self._seen], axis=0)) <= self._spread)
