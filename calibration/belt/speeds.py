"""The speeds that a belt has lately had: what it starts to, stops from, and how often."""

from bisect import bisect_left, bisect_right

import numpy as np

from calibration.belt.forecast import NEVER, Changes
from cell.poses import Array

_REMEMBERED = 30.0  # s
_FEW = 5  # speeds that tell nothing
_HARD = 0.15  # m/s^2
_WORTH = 0.2  # of the span of speeds; stamps that come late look like smaller changes
_RESTS = 0.02  # of the span
_MOST = 8192
_STOOD = 50.0  # counts/s, of a belt that stands: what rounding of a few frames makes
_ROOM = 0.5  # of the span, for a belt that is set to another speed


class Speeds:
    """Mean speeds (counts/s) over a few frames each, by the stamp of the last frame."""

    def __init__(self) -> None:
        self._t: list[float] = []
        self._v: list[float] = []

    def add(self, t: float, speed: float) -> None:
        """One more, later than all before."""
        self._t.append(t)
        self._v.append(speed)
        if len(self._t) > 2 * _MOST:
            del self._t[:_MOST], self._v[:_MOST]

    def _lately(self, now: float) -> slice:
        return slice(bisect_left(self._t, now - _REMEMBERED), bisect_right(self._t, now))

    def range(self, now: float, speed: float) -> tuple[float, float]:
        """Speeds that a belt which runs at ``speed`` and starts or stops will not go beyond.

        It stops at rest, and starts to the highest speed that it had; a belt at its highest has no bound.
        """
        seen = self._v[self._lately(now)]
        low, high = min([0.0, speed, *seen]), max([0.0, speed, *seen])
        moves = _RESTS * (high - low)  # slower is a belt that rests, in the noise of its counts
        if speed > max(0.98 * high, moves):
            high = np.inf
        if speed < min(0.98 * low, -moves):
            low = -np.inf
        return low, high

    def believable(self, now: float) -> tuple[float, float]:
        """Speeds (counts/s) that counts in bursts may tell: those of the last 30 s, with room on either side.
        Any where fewer than five are known, and of a belt that only stood."""
        v = np.array(self._v[self._lately(now)])
        if len(v) < _FEW:
            return -np.inf, np.inf
        v = _middle(v[:-2], v[1:-1], v[2:])  # one late stamp makes one speed of three wrong
        low, high = min(float(v.min()), 0.0), max(float(v.max()), 0.0)
        if high - low < _STOOD:
            return -np.inf, np.inf
        return low - _ROOM * (high - low), high + _ROOM * (high - low)

    def changes(self, now: float, m_per_count: float) -> Changes:
        """Starts and stops of the last seconds."""
        rows = self._lately(now)
        t, v = np.array(self._t[rows]), np.array(self._v[rows]) * abs(m_per_count)
        if len(t) < _FEW:
            return NEVER
        t, v = t[1:-1], _middle(v[:-2], v[1:-1], v[2:])  # one late stamp makes one speed of three wrong
        span = float(max(v.max(), 0.0) - min(v.min(), 0.0))
        gained = np.diff(v)
        a = gained / np.diff(t)
        sign = np.sign(a) * (np.abs(a) > _HARD)
        begins = np.flatnonzero(np.diff(sign, prepend=np.inf))
        real = (sign[begins] != 0.0) & (np.abs(np.add.reduceat(gained, begins)) >= _WORTH * span)
        if not real.any():
            return NEVER
        hard = np.repeat(real, np.diff(begins, append=len(a)))
        rate = 2.0 * float(np.sum(real)) / float(t[-1] - t[0])  # each begins and ends
        return Changes(rate, float(np.sqrt(np.mean(a[hard] ** 2))), span)


def _middle(a: Array, b: Array, c: Array) -> Array:
    """The median of three, element by element."""
    return np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
