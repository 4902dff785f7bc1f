"""In which order to visit poses: short in joint travel, every way between two of them free."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cell.errors import CellError
from cell.poses import Array

Check = Callable[[Array, Array], None]
"""``check(q0, q1)`` raises a ``CellError`` when that joint path is not free."""
_PASSES = 20


@dataclass(frozen=True, eq=False)
class Tour:
    """``rows`` in the order of the visits, ``via`` (the same length) says which go by way of the hub, and
    ``lost`` maps the rows that cannot be got to to the reason."""

    rows: list[int]
    via: list[bool]
    lost: dict[int, str]


def tour(start: Array, Q: Array, check: Check, hub: Array) -> Tour:
    """Visit all of ``Q`` (n, j) from ``start`` (j,), straight in joint space or by way of ``hub`` (j,)."""
    here, rows, via, lost = start, list[int](), list[bool](), dict[int, str]()
    waiting = shortest(start, Q)
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


def shortest(start: Array, Q: Array) -> list[int]:
    """An order of ``Q`` (n, j) with little travel: nearest neighbours, then 2-opt (Croes 1958).

    Travel is that of the joint with the longest way, which sets the time.
    """
    n = len(Q)
    points = np.vstack([start[None], Q])
    away = np.max(np.abs(points[:, None] - points[None]), axis=2)
    order, free = [0], set(range(1, n + 1))
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
