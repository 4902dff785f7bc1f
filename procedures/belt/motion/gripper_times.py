"""How long the gripper takes to close on an item, and to open, as its own answers show."""

from collections import deque

_REMEMBERED = 20
_ASSUMED = 1.0 / 3.0  # of the timeout, until it has closed once
_NEAR = 0.8  # of the timeout


class GripperTimes:
    """Times (s) from the command to the answer; ``timeout_s`` is how long an answer is waited for.

    Where nothing is ``confirmed``, answers come by the clock, whatever the gripper does.
    """

    def __init__(self, timeout_s: float, confirmed: bool = True) -> None:
        self._timeout_s, self.confirmed = timeout_s, confirmed
        self._took: dict[bool, deque[float]] = {c: deque(maxlen=_REMEMBERED) for c in (True, False)}

    def add(self, closing: bool, took_s: float) -> None:
        """It has answered."""
        self._took[closing].append(took_s)

    @property
    def closing_s(self) -> float | None:
        """The longest of the last times to close; None before the first."""
        return max(self._took[True], default=None)

    @property
    def opening_s(self) -> float | None:
        """And to open."""
        return max(self._took[False], default=None)

    @property
    def expected_s(self) -> float:
        """What a motion of the gripper is taken to last."""
        return self._timeout_s * _ASSUMED if self.closing_s is None else self.closing_s

    @property
    def tight(self) -> str | None:
        """One sentence when the timeout leaves little more than the gripper needs."""
        longest = max((took for both in self._took.values() for took in both), default=0.0)
        if longest <= _NEAR * self._timeout_s:
            return None
        return (
            f"the gripper took {longest:.2f} s, and grip_timeout_s is {self._timeout_s:g} s: make it longer"
        )
