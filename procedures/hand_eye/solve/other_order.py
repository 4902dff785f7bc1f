"""In which other order flange poses fit the images: reversed, shifted, or any, where the angles tell."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.closed_form import closed_form
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import Solution
from cell.poses import Array
from procedures.hand_eye.solve.other_writing import LEVER_M

Order = NDArray[np.int64]
FEWEST_ORDERED = 5  # of fewer poses some order fits always
_SHIFTS = 3  # that are tried, the best ones by their angles
_ROUNDS = 5
_MOST = 200  # observations that are compared with each other
_AS_GOOD = 4.0  # times the median of the observations in use


def other_orders(problem: Problem) -> Iterator[tuple[str, Order]]:
    """Orders (n,) worth a look, in words: pose ``order[k]`` belongs to image k."""
    n = problem.n
    if n < FEWEST_ORDERED:
        return
    forward = np.arange(n)
    for order in _shifted(problem):
        step = int(order[0])
        if np.array_equal(order, forward[::-1]):
            yield "in reversed order", order
        elif order[1] == (order[0] + 1) % n:
            places = step if step <= n // 2 else step - n
            yield f"shifted by {places} places", order
        else:
            yield "reversed and shifted", order
    start = _by_angles(problem) if problem.groups == 1 else forward
    yield "in another order", _settled(problem, start)


def _shifted(problem: Problem) -> list[Order]:
    """The shifts, forwards and backwards, whose turns from pose to pose are most like the camera's."""
    n = problem.n
    arm, camera = angles(problem.G), angles(problem.C)
    k = np.flatnonzero(problem.group[1:] == problem.group[:-1])
    forward = np.arange(n)
    found = []
    for order in (forward, forward[::-1]):
        for shift in range(n):
            rows = np.roll(order, shift)
            if np.array_equal(rows, forward):
                continue
            off = float(np.median(np.abs(arm[rows[k], rows[k + 1]] - camera[k, k + 1])))
            found.append((off, shift, rows))
    found.sort(key=lambda one: one[:2])
    return [rows for _, _, rows in found[:_SHIFTS]]


def _assigned(cost: Array) -> tuple[Order, Order]:
    """Rows and columns (k,) of the entries of least sum, one in each row and column."""
    from scipy.optimize import linear_sum_assignment  # 12 MB that a good set has no use for

    rows, columns = linear_sum_assignment(cost)
    return rows, columns


def _by_angles(problem: Problem) -> Order:
    """Each image gets the pose whose angles to all others are most like its own."""
    arm, camera = np.sort(angles(problem.G), axis=1), np.sort(angles(problem.C), axis=1)
    cost = np.linalg.norm(arm[None] - camera[:, None], axis=2)
    return _assigned(cost)[1]


def _settled(problem: Problem, order: Order) -> Order:
    """``order`` with every image given the pose that predicts it best, until that changes nothing."""
    for _ in range(_ROUNDS):
        now = replace(problem, G=problem.G[order])
        at = closed_form(now)
        cost = distances(problem, at.X, at.W)
        better = _assigned(cost)[1]
        if np.array_equal(better, order):
            break
        order = better
    return order


def distances(problem: Problem, X: Array, W: Array) -> Array:
    """(n, n) metres: how far image k is from where flange pose l puts the target of its group."""
    predicted = (se3.inverse(X) @ problem.G)[None] @ W[problem.group][:, None]
    return _away(predicted, problem.C[:, None])


def _away(T: Array, other: Array) -> Array:
    """Distance in metres between poses (.., 4, 4), a turn by its lever."""
    shift = np.linalg.norm((T - other)[..., :3, 3], axis=-1)
    trace = np.sum(T[..., :3, :3] * other[..., :3, :3], axis=(-2, -1))
    return np.asarray(shift + LEVER_M * np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))


def exchanged(solution: Solution) -> list[tuple[int, int]]:
    """(image, pose) of observations that were left out and fit crosswise, as well as those that are used."""
    problem, used = solution.problem, solution.used
    known = np.searchsorted(solution.groups, problem.group)
    of_group = np.isin(problem.group, solution.groups)
    out = np.flatnonzero(~used & of_group)[:_MOST]
    kept = np.flatnonzero(used)
    if len(out) <= 1:
        return []
    W = solution.at.W
    predicted = se3.inverse(solution.at.X) @ problem.G[kept] @ W[known[kept]]
    limit = _AS_GOOD * float(np.median(_away(predicted, problem.C[kept])))
    part = replace(problem, G=problem.G[out], C=problem.C[out], group=known[out])
    cost = distances(part, solution.at.X, W)
    return [
        (int(out[i]), int(out[k]))
        for i, k in zip(*_assigned(cost), strict=True)
        if i != k and cost[i, k] < limit < cost[i, i]
    ]


def angles(T: Array) -> Array:
    """Angles (n, n) in radians between rotations."""
    trace = np.einsum("iab,jab->ij", T[:, :3, :3], T[:, :3, :3])
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
