"""How often an input has changed, from what its level and its edge counter show at each poll."""


class CounterJump(Exception):
    """A counter that no input can have brought to where it is: the module was restarted or cleared."""

    def __init__(self, before: int, now: int) -> None:
        super().__init__(f"from {before} to {now}")
        self.before, self.now = before, now


class ChangeCount:
    """Changes of one input since the first poll: never fewer than before, and even when the level is as then.

    With n rising edges counted between two polls, the level has changed 2n times when it is the same at both,
    2n - 1 times from off to on, and 2n + 1 times from on to off. An input that is shown inverted changes
    exactly as often, so electrical levels serve.

    The level may be ahead of its counter by the rising edge that came between the reading of the two. That
    edge is taken from the level and owed by the counter until the next poll, which must show it.
    """

    def __init__(self, level: bool, count: int | None, width: int = 32) -> None:
        self.changes = 0
        self.unseen = 0  # rising edges that the level showed and the counter never did
        self._level, self._count, self._modulus = level, count, 1 << width
        self._owed = 0

    def take(self, level: bool, count: int | None, most: float) -> None:
        """One more poll; ``CounterJump`` when the counter moved on by more than ``most``."""
        if count is None or self._count is None:
            self.changes += level != self._level
            self._level = level
            return
        counted = (count - self._count) % self._modulus
        if counted > most:
            raise CounterJump(self._count, count)
        paid = min(counted, self._owed)
        self.unseen = self.unseen + 1 if self._owed > paid else 0 if counted else self.unseen
        changed = 2 * (counted - paid) + self._level - level
        self._owed = 1 if changed < 0 else 0
        self.changes += abs(changed)
        self._level, self._count = level, count
