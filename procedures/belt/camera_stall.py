"""A camera whose pictures stay away: no new items, while those that are known can still be picked."""


class Stall:
    """Told of every picture, and asked now and then. Times in s; the wait begins with the first question."""

    def __init__(self, after_s: float) -> None:
        self._after_s = after_s
        self._last: float | None = None
        self.on = False
        self.count = 0
        self.longest_s = 0.0
        self._lasted = 0.0

    def picture(self, t: float) -> None:
        """One has come."""
        self._last = t

    def look(self, now: float) -> float | None:
        """How long there has been no picture, when that begins or ends to be a stall; else None.

        At its end it is the time without pictures as far as it was looked at.
        """
        self._last = now if self._last is None else self._last
        waited = now - self._last
        stalled = waited > self._after_s
        changed, self.on = stalled is not self.on, stalled
        if stalled:
            self.count += changed
            self._lasted = waited
            self.longest_s = max(self.longest_s, waited)
        return (waited if stalled else self._lasted) if changed else None
