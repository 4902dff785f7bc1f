"""Counts that go on where the encoder's own range wraps, and the number of frames that did not come."""

_SETTLED = 12  # frames; a burst after a stall is shorter
_LOST = 0.6  # of a period: later than that and a frame is missing; lost ones are rarer than late ones


class Unwrap:
    """Takes the shorter way round; ``modulus``, at least 2, need not be a power of two.

    So a belt may move by half the range between two frames. Stamps are no help beyond that: frames that were
    held up and frames that were lost look alike in them.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._last: int | None = None
        self._count = 0

    def take(self, raw: int) -> int:
        """The unwrapped count; the first is 0. ``ValueError`` outside the range."""
        if not 0 <= raw < self._modulus:
            raise ValueError(f"{raw} is outside 0 to {self._modulus - 1}")
        if self._last is not None:
            half = self._modulus // 2
            self._count += (raw - self._last + half) % self._modulus - half
        self._last = raw
        return self._count


class Missing:
    """How many frames of a periodic sender were lost, from the times of those that came.

    One that comes late looks as if others were missing, until as many come early. So losses are told when
    no burst has made them good: a dozen frames later, and as many more as seem to be missing.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._anchor: float | None = None  # the last frame up to which none was missing
        self._frames, self._most = 0, 0  # since then: how many came, how many seemed to be missing

    def add(self, t: float) -> int:
        """One more frame, heard at ``t`` (s); the number of losses that are certain now."""
        if self._anchor is None:
            self._anchor = t
            return 0
        self._frames += 1
        missing = int((t - self._anchor) / self._period_s + 1.0 - _LOST) - self._frames
        self._most = max(self._most, missing)
        if missing > 0 and self._frames < _SETTLED + self._most:
            return 0
        self._anchor, self._frames, self._most = t, 0, 0
        return max(missing, 0)
