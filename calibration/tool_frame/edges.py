"""From polls to edges: each change of the input with the interval of time that it lies in."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array


@dataclass(frozen=True, slots=True)
class Bracket:
    """One change, seen between the polls at ``low`` and ``high`` (s); ``soft`` is how far their times may be
    off (half-width of a poll), ``rising`` that the beam was broken then."""

    low: float
    high: float
    soft: float
    rising: bool


def brackets(
    t: Array, v: NDArray[np.bool_], n: NDArray[np.int64] | None = None, dt: Array | None = None
) -> list[Bracket]:
    """All changes between polls at ``t`` (m,) s that saw ``v`` (m,), oldest first; ``n`` (m,) counts them,
    and ``dt`` (m,) s is half of each poll's time. The changes of a pulse between two polls share an interval.

    The counter is believed where it agrees with the levels: an odd number of changes where the level
    changed. A counter that was reset, or counts something else, is left aside.
    """
    changed = np.diff(v.astype(np.int8)) != 0
    counts = changed.astype(np.int64)
    if n is not None:
        steps = np.diff(n)
        if np.all(steps >= 0) and np.array_equal(steps % 2 == 1, changed):
            counts = steps
    edges: list[Bracket] = []
    for j in np.flatnonzero(counts):
        soft = 0.0 if dt is None else float(max(dt[j], dt[j + 1]))
        rising = not bool(v[j])
        for _ in range(int(counts[j])):
            edges.append(Bracket(float(t[j]), float(t[j + 1]), soft, rising))
            rising = not rising
    return edges


def merged(edges: list[Bracket], share: float = 0.03) -> list[Bracket]:
    """Edges with bounce taken out: changes much closer together than the crossing is long are one change.

    Groups of an odd number become one edge, whose interval covers the group; groups of an even number, a
    flicker, vanish.
    """
    if len(edges) <= 2:
        return edges
    near = share * (edges[-1].high - edges[0].low)
    groups: list[list[Bracket]] = []
    for edge in edges:
        if groups and edge.high - groups[-1][-1].high < near:
            groups[-1].append(edge)
        else:
            groups.append([edge])
    return [Bracket(g[0].low, g[-1].high, max(e.soft for e in g), g[0].rising) for g in groups if len(g) % 2]
