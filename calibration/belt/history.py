"""Counts in the order in which they came, under indices that stay; the oldest are forgotten in the end."""

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_MOST = 2**19  # frames; nine minutes at 1 kHz, three quarters of an hour at 200 Hz


class History:
    """Stamps (s), unwrapped counts and frame numbers; frame k keeps its index when older ones are dropped."""

    def __init__(self, most: int = _MOST) -> None:
        self._most = most
        self._dropped = 0
        self._kept = 0
        self._t, self._n = np.zeros(4096), np.zeros(4096)
        self._slot = np.zeros(4096, dtype=np.int64)

    def __len__(self) -> int:
        """Frames so far, forgotten ones included."""
        return self._dropped + self._kept

    @property
    def first(self) -> int:
        """Index of the oldest frame that is kept."""
        return self._dropped

    def add(self, t: float, n: float, slot: int) -> None:
        """One more frame."""
        if self._kept == self._most:
            self._forget(self._most // 2)
        if self._kept == len(self._t):
            size = 2 * len(self._t)
            self._t, self._n = np.resize(self._t, size), np.resize(self._n, size)
            self._slot = np.resize(self._slot, size)
        k = self._kept
        self._t[k], self._n[k], self._slot[k] = t, n, slot
        self._kept = k + 1

    def _forget(self, count: int) -> None:
        # New arrays: views that were handed out stay as they are.
        self._t, self._n = self._t[count:].copy(), self._n[count:].copy()
        self._slot = self._slot[count:].copy()
        self._dropped += count
        self._kept -= count

    def t(self, begin: int, end: int) -> Array:
        """Stamps of frames ``begin`` to ``end`` (excluded)."""
        return self._t[self._rows(begin, end)]

    def n(self, begin: int, end: int) -> Array:
        """Unwrapped counts, zero at the first frame."""
        return self._n[self._rows(begin, end)]

    def slots(self, begin: int, end: int) -> NDArray[np.int64]:
        """Frame numbers, lost frames counted."""
        return self._slot[self._rows(begin, end)]

    def _rows(self, begin: int, end: int) -> slice:
        return slice(max(begin - self._dropped, 0), max(end - self._dropped, 0))

    def at(self, k: int) -> tuple[float, float]:
        """Stamp and count of frame k."""
        return float(self._t[k - self._dropped]), float(self._n[k - self._dropped])

    def find(self, t: float, size: int) -> int:
        """How many of the first ``size`` frames are stamped before ``t``."""
        return self._dropped + int(np.searchsorted(self._t[: size - self._dropped], t))
