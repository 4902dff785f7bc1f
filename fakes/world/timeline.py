"""A value as a function of time that changes in steps."""

from bisect import bisect_right
from math import inf
from typing import Generic, TypeVar

T = TypeVar("T")


class Timeline(Generic[T]):
    """A value that changes at known times; what was planned for later goes with every new change."""

    def __init__(self, first: T) -> None:
        self._times, self._values = [-inf], [first]

    def at(self, t: float) -> T:
        return self._values[bisect_right(self._times, t) - 1]

    def put(self, t: float, value: T) -> None:
        """The value from ``t`` on."""
        keep = max(bisect_right(self._times, t), 1)
        self._times[keep:], self._values[keep:] = [t], [value]

    def then(self, t: float, value: T) -> None:
        """Plan a change after all others."""
        self._times.append(t)
        self._values.append(value)
