"""The speeds that a belt has lately had: what it starts to, stops from, and how often."""

from bisect import bisect_left, bisect_right

import numpy as np

from calibration.belt.forecast import Changes

_REMEMBERED = 30.0  # s
_HARD = 0.15  # m/s^2
_MOST = 8192


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
        if 0.0 < 0.98 * high < speed:
            high = np.inf
        if speed < 0.98 * low < 0.0:
            low = -np.inf
        return low, high

    def changes(self, now: float, m_per_count: float) -> Changes:
        """Starts and stops of the last seconds."""
        rows = self._lately(now)
        t, v = np.array(self._t[rows]), np.array(self._v[rows])
        if len(t) < 3:
            return Changes(0.0, 0.0)
        a = np.diff(v) / np.diff(t) * m_per_count
        hard = np.abs(a) > _HARD
        if not hard.any():
            return Changes(0.0, 0.0)
        begins = int(np.sum(hard[1:] != hard[:-1]))
        return Changes(begins / float(t[-1] - t[0]), float(np.sqrt(np.mean(a[hard] ** 2))))
