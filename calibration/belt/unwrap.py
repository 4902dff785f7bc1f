"""Encoder counts that wrap at the encoder's own range, turned into counts that go on.

The range (CiA 406 object 6002h) need not be a power of two, so steps are taken modulo the range itself.
"""

from dataclasses import dataclass, field

_FASTEST = 5.0  # m/s; no belt that a robot picks from is faster
_SPARE_COUNTS = 3.0
_CONFIRM = 3  # counts in a row that agree on a jump make it a new zero, fewer are misread frames


@dataclass
class Unwrapper:
    """Counts one after the other, oldest first; each becomes an unwrapped count or is left out.

    ``modulus`` is the range in counts, None for a counter that does not wrap. ``fastest`` is the highest
    believable speed in counts per second. A step that no belt can make is a misread frame; when
    ``_CONFIRM`` counts in a row agree with each other instead, the encoder has been reset: counting goes on
    from there, and the travel in between is bridged with the speed from before.
    """

    modulus: int | None
    fastest: float
    misread: int = 0
    resets: list[float] = field(default_factory=list)
    _offset: int = 0
    _last: tuple[float, int] | None = None  # time, unwrapped
    _speed: float = 0.0  # counts per second, of the last steps
    _doubtful: list[tuple[float, int]] = field(default_factory=list)

    def add(self, t: float, count: int) -> int | None:
        """The unwrapped count at ``t`` (s), or None while it is not believed."""
        if self._last is None:
            self._last = (t, count)
            return count
        t0, n0 = last = self._last
        n = self._nearest(count + self._offset, n0 + self._speed * min(t - t0, 1.0))
        if self._possible(t0, n0, t, n):
            self.misread += len(self._doubtful)
            self._doubtful.clear()
            return self._take(last, t, n)
        return self._doubt(last, t, count)

    def _take(self, last: tuple[float, int], t: float, n: int) -> int:
        t0, n0 = last
        if t > t0:
            share = min(1.0, (t - t0) / 0.03)  # the speed of the last 30 ms or so
            self._speed += share * ((n - n0) / (t - t0) - self._speed)
        self._last = (t, n)
        return n

    def _nearest(self, n: int, expected: float) -> int:
        if self.modulus is None:
            return n
        return n + self.modulus * round((expected - n) / self.modulus)

    def _possible(self, t0: float, n0: int, t: float, n: int) -> bool:
        return abs(n - n0) <= self.fastest * max(t - t0, 0.02) + _SPARE_COUNTS

    def _doubt(self, last: tuple[float, int], t: float, count: int) -> int | None:
        if self._doubtful:
            t1, c1 = self._doubtful[-1]
            if not self._possible(t1, c1, t, self._nearest(count, c1)):
                self.misread += len(self._doubtful)
                self._doubtful.clear()
        self._doubtful.append((t, count))
        if len(self._doubtful) < _CONFIRM:
            return None
        return self._restart(last, t, count)

    def _restart(self, last: tuple[float, int], t: float, count: int) -> int:
        t0, n0 = last
        n = round(n0 + self._speed * min(t - t0, 1.0))
        self._offset = n - count
        self._doubtful.clear()
        self.resets.append(t)
        self._last = (t, n)
        return n


def fastest_counts(m_per_count: float) -> float:
    """The highest believable speed in counts per second."""
    return _FASTEST / abs(m_per_count)
