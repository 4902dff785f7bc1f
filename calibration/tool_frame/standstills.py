"""Ways that are off together.

The arm comes to rest off by its repeatability, and under way it is off by a part of the standstill behind and
a part of the one ahead. So both edges of one way are off by nearly the same, and of two ways that have a
standstill in common each has half of its variance from there.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calibration.tool_frame.scene import Pass
from cell.poses import Array

SHARED = 0.5  # of a way's variance, from the standstill that it has in common with the next
WITHIN = 0.9  # of an edge's variance, common to its way: where it is not walked through, and to begin with
_SAME_PLACE_M = 2e-4


def in_a_row(passes: Mapping[int, Pass]) -> list[tuple[int, int]]:
    """Those of ``passes`` (by their places in the scene) with a standstill and nothing else between them.
    Stamps of the reference and of the current set need not be of one clock."""
    found = []
    for a, b in pairwise(sorted(passes, key=lambda k: (passes[k].current, float(passes[k].pose_t[0])))):
        gap = passes[b].pose_xyz[0] - passes[a].pose_xyz[-1]
        if passes[a].current == passes[b].current and float(np.linalg.norm(gap)) < _SAME_PLACE_M:
            found.append((a, b))
    return found


def of_standstills(ways: Sequence[int], neighbours: Sequence[tuple[int, int]]) -> Array:
    """(n, q) by how much of what the arm is off by at each of q standstills each of ``ways`` (n,) is off, all
    of them alike on the whole. Ways are named by their places in the scene, and so are ``neighbours``, the
    pairs of them with one standstill; those of ways in a row are next to each other. A way that shares none
    has one of its own."""
    number = {k: i for i, k in enumerate(ways)}
    after = {number[a]: number[b] for a, b in neighbours if a in number and b in number}
    columns: list[Array] = []

    def another(*own: int) -> None:
        column = np.zeros(len(ways))
        column[list(own)] = 1.0
        columns.append(column)

    for first in sorted(set(range(len(ways))) - set(after.values())):
        another(first)
        way = first
        while way in after:
            another(way, after[way])
            way = after[way]
        if way != first:
            another(way)
    found = np.stack(columns, axis=1)
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found


def alternating(of_stand: Array) -> list[list[int]]:
    """The standstills (their columns in ``of_stand``) in sets of which no way has two."""
    sets: list[list[int]] = []
    for stand in range(of_stand.shape[1]):
        ways = of_stand[:, stand] > 0.0
        free = next((own for own in sets if not (of_stand[:, own][ways] > 0.0).any()), None)
        if free is None:
            sets.append([stand])
        else:
            free.append(stand)
    return sets


def of_edges(source: NDArray[np.int64], neighbours: Sequence[tuple[int, int]]) -> Array:
    """(n, n) correlation of what the arm is off by at edges; ``source`` (n,) are the places of their ways."""
    places, own = np.unique(source, return_inverse=True)
    of_stand = of_standstills(places.tolist(), neighbours)[own]
    found: Array = WITHIN * of_stand @ of_stand.T
    np.fill_diagonal(found, 1.0)
    return found
