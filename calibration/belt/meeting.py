"""Where and when the arm can first touch an item that moves on.

The earliest root of ``T(|p(t) - w|) + t2 = t - t0``, T the jerk-limited time of the slower
axis, t2 that of the straight descent. With a zone the contact must lie between its edges for the whole dwell;
an item that is not in the zone yet is waited for above the meeting point.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_STEP = 0.005  # s; a belt's motion is smooth over so little
_FARTHEST = 30.0  # s; nobody waits longer for an item
_CHUNK = 1.0  # s
_EXACT = 1e-9  # s
_HALVINGS = 23  # of a step; stamps since 1970 are not exact enough to wait for less


@dataclass(frozen=True)
class Zone:
    """Range along the belt, m; None: no edge on that side."""

    low: float | None
    high: float | None

    def holds(self, along: Array) -> NDArray[np.bool_]:
        """Which positions (k,) lie inside."""
        inside = np.ones(len(along), dtype=bool)
        if self.low is not None:
            inside &= along >= self.low
        if self.high is not None:
            inside &= along <= self.high
        return inside


def meeting_time(
    t0: float,
    arm_time: Callable[[Array], Array],
    along: Callable[[Array], Array],
    zone: Zone,
    dwell: float,
) -> float | None:
    """Earliest contact time after ``t0``, or None when the item cannot be met.

    ``arm_time(t)`` (k,) is how long the arm needs to touch the item where it will be at t; ``along(t)`` (k,)
    where along the belt the item will be; both for times (k,) in s.
    """

    def possible(t: Array) -> NDArray[np.bool_]:
        reached = arm_time(t) <= t - t0 + _EXACT
        return np.asarray(reached & zone.holds(along(t)) & zone.holds(along(t + dwell)))

    for start in np.arange(0.0, _FARTHEST, _CHUNK):
        grid = t0 + start + np.arange(0.0, _CHUNK + 0.5 * _STEP, _STEP)
        good = np.flatnonzero(possible(grid))
        if len(good):
            k = int(good[0])
            return float(grid[0]) if k == 0 else _bisect(possible, float(grid[k - 1]), float(grid[k]))
    return None


def _bisect(possible: Callable[[Array], NDArray[np.bool_]], low: float, high: float) -> float:
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if bool(possible(np.array([middle]))[0]):
            high = middle
        else:
            low = middle
    return high
