"""Counts that go on where the encoder's own range wraps, and the number of frames that did not come."""

_SETTLED = 12  # frames; a burst after a stall is shorter
_LOST = 0.6  # of a period: later than that and a frame is missing; lost ones are rarer than late ones
_RATE = 0.3  # how fast the speed follows


class Unwrap:
    """Takes the shortest way from where the count is expected; ``modulus`` need not be a power of two."""

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._last: tuple[float, int] | None = None  # t, raw
        self._speed = 0.0  # counts a second
        self._count = 0

    def take(self, t: float, raw: int) -> int:
        """The unwrapped count at ``t`` (s); the first is 0. ``ValueError`` outside the range."""
        if not 0 <= raw < self._modulus:
            raise ValueError(f"{raw} is outside 0 to {self._modulus - 1}")
        if self._last is not None:
            t0, raw0 = self._last
            passed = t - t0
            expected = round(self._speed * passed)
            half = self._modulus // 2
            step = (raw - raw0 - expected + half) % self._modulus - half + expected
            self._count += step
            if passed > 0.0:
                self._speed += _RATE * (step / passed - self._speed)
        self._last = t, raw
        return self._count


class Missing:
    """How many frames of a periodic sender were lost, from the stamps of those that came.

    One that comes late looks as if others were missing, until as many come early. So losses are told when
    no burst has made them good: a dozen frames later, and as many more as seem to be missing.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._last: float | None = None
        self._pending, self._since, self._wait = 0, 0, _SETTLED

    def add(self, t: float) -> int:
        """One more frame, stamped ``t`` (s); the number of losses that are certain now."""
        last, self._last = self._last, t
        if last is None:
            return 0
        missing = int((t - last) / self._period_s + 1.0 - _LOST) - 1
        if not self._pending:
            self._since, self._wait = 0, _SETTLED
        self._pending += missing
        self._wait += max(missing, 0)
        self._since += 1
        if self._since < self._wait:
            return 0
        lost, self._pending, self._since = max(self._pending, 0), 0, 0
        return lost
