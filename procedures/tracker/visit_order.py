"""In which order to visit poses: short in joint travel, every way between two of them free.

Where every joint shall turn far from pose to pose, a step that is too short counts as a very long way.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.errors import CellError
from cell.poses import Array

Check = Callable[[Array, Array], None]
"""``check(q0, q1)`` raises a ``CellError`` when that joint path is not free."""
_PASSES = 20
_TOO_SHORT_RAD = 1e3  # longer than any tour


@dataclass(frozen=True, eq=False)
class Tour:
    """``rows`` in the order of the visits, ``via`` (the same length) says which go by way of the hub, and
    ``lost`` maps the rows that cannot be got to to the reason."""

    rows: list[int]
    via: list[bool]
    lost: dict[int, str]


@dataclass(frozen=True, eq=False)
class FarSteps:
    """Every joint shall turn by more than ``least`` (j,) rad from each pose of ``counted`` (n,) to the next
    one of them, and to the first from ``last`` (j,), which was counted before them; None: nothing was. The
    others come in between, where it is not far."""

    last: Array | None
    least: Array
    counted: NDArray[np.bool_]

    def order(self, start: Array, Q: Array) -> list[int]:
        """An order of ``Q`` (n, j) with little travel from ``start`` (j,), and as few steps that are too
        short as is found."""
        away = _away(np.vstack([start[None], Q]))
        away[1:, 1:][self._short(Q[:, None], Q[None])] += _TOO_SHORT_RAD
        if self.last is not None:
            away[0, 1:][self._short(self.last, Q)] += _TOO_SHORT_RAD
        solving = np.concatenate([[0], np.flatnonzero(self.counted) + 1])
        path = [0, *(int(solving[row + 1]) for row in _order(away[np.ix_(solving, solving)]))]
        for k in np.flatnonzero(~self.counted) + 1:
            before, after = path[:-1], path[1:]
            longer = away[before, k] + away[after, k] - away[before, after]
            path.insert(int(np.argmin(longer)) + 1 if len(longer) else 1, int(k))
        return [k - 1 for k in path[1:]]

    def _short(self, q0: Array, q1: Array) -> NDArray[np.bool_]:
        short: NDArray[np.bool_] = np.any(np.abs(q0 - q1) <= self.least, axis=-1)
        return short


def tour(start: Array, Q: Array, check: Check, hub: Array, far: FarSteps | None = None) -> Tour:
    """Visit all of ``Q`` (n, j) from ``start`` (j,), straight in joint space or by way of ``hub`` (j,)."""
    here, rows, via, lost = start, list[int](), list[bool](), dict[int, str]()
    waiting = shortest(start, Q) if far is None else far.order(start, Q)
    for last_try in (False, True):
        postponed = []
        for row in waiting:
            by_hub = False
            why = blocked(here, Q[row], check)
            if why is not None:
                by_hub = blocked(here, hub, check) is None and blocked(hub, Q[row], check) is None
            if why is None or by_hub:
                rows.append(row)
                via.append(by_hub)
                here = Q[row]
            elif last_try:
                lost[row] = why
            else:
                postponed.append(row)
        waiting = postponed
    return Tour(rows, via, lost)


def blocked(q0: Array, q1: Array, check: Check) -> str | None:
    """Why the joint path is not free, or None."""
    try:
        check(q0, q1)
    except CellError as exc:
        return exc.detail
    return None


def travel(path: Array) -> Array:
    """(n - 1,) rad: the way of the joint that turns farthest, which sets the time, on each step of ``path``
    (n, j)."""
    way: Array = np.max(np.abs(np.diff(path, axis=0)), axis=1)
    return way


def shortest(start: Array, Q: Array) -> list[int]:
    """An order of ``Q`` (n, j) with little :func:`travel`."""
    return _order(_away(np.vstack([start[None], Q])))


def _away(points: Array) -> Array:
    away: Array = np.max(np.abs(points[:, None] - points[None]), axis=2)
    return away


def _order(away: Array) -> list[int]:
    """An order of the points after the first, counted from 0: nearest neighbours, then 2-opt (Croes 1958).
    ``away`` (n + 1, n + 1) is the way between two of them."""
    order, free = [0], set(range(1, len(away)))
    while free:
        nearest = min(free, key=lambda k: (away[order[-1], k], k))
        order.append(nearest)
        free.remove(nearest)
    path = np.array(order)
    for _ in range(_PASSES):
        if not _untangle(path, away):
            break
    return [int(k) - 1 for k in path[1:]]


def _untangle(path: Array, away: Array) -> bool:
    """Turn round stretches of ``path`` (n + 1,) that are shorter the other way; False when there are none."""
    changed = False
    for i in range(1, len(path) - 1):
        ends = np.arange(i + 1, len(path))
        before = away[path[i - 1], path[i]]
        after = np.append(away[path[ends[:-1]], path[ends[:-1] + 1]], 0.0)
        joined = np.append(away[path[i], path[ends[:-1] + 1]], 0.0)
        gain = before + after - away[path[i - 1], path[ends]] - joined
        best = int(np.argmax(gain))
        if gain[best] > 1e-9:
            path[i : ends[best] + 1] = path[i : ends[best] + 1][::-1].copy()
            changed = True
    return changed
