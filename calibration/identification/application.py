"""Joints that bring the calibrated flange to a wanted place: the inverse of an arm that has no closed form.

A pose is wanted of an arm with six joints or more; a palletizer, whose flange stays level, has four numbers:
x, y, z and the heading (yaw) of the flange's x axis about base z.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.kinematics.chain import SerialChain, pose_gap
from calibration.kinematics.families import arm_spec
from cell.formats.robot import parse_robot
from cell.poses import Array

TOLERANCE = 1e-9  # m and rad
_STEPS = 60
_LARGEST = 0.4  # rad at the links, or m, in one step
_STARTS = (6, 24, 60)  # of the closest known poses: that many are tried before more are
_INSIDE = (12, 48)  # starts within the ranges: these first, all where none of them leads inside
_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Reached:
    """``q`` (k, j), NaN where nothing was found, and ``miss`` (k,), how far the best attempt stayed off
    (largest of m and rad)."""

    q: Array
    miss: Array

    @property
    def found(self) -> NDArray[np.bool_]:
        """(k,): whether the place was reached."""
        return self.miss < TOLERANCE * 1e3


def chain_of(robot: Mapping[str, Any]) -> SerialChain:
    """The chain of a ROBOT: the ``robot`` of ``kinematics.<device>``, or what a controller believes."""
    return arm_spec(parse_robot(robot, "robot")).arm.base


def goals_from_yaw(rows: Array) -> Array:
    """(k, 4, 4) level poses from x, y, z, yaw (k, 4)."""
    c, s = np.cos(rows[:, 3]), np.sin(rows[:, 3])
    out = np.tile(np.eye(4), (len(rows), 1, 1))
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = c, -s, s, c
    out[:, :3, 3] = rows[:, :3]
    return out


def yaw_of(T: Array) -> Array:
    """(k,): heading of the x axis of poses (k, 4, 4) about base z."""
    out: Array = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    return out


def reach(chain: SerialChain, goals: Array, q_near: Array | None, known: Array, level: bool) -> Reached:
    """Joints for the poses ``goals`` (k, 4, 4) in the base.

    ``q_near`` (k, j) picks the branch; without it, and where it does not lead there, the joints of ``known``
    (n, j) whose flange is closest are tried. ``level``: only x, y, z and the heading are wanted.
    """
    at = chain.flange(known)
    order = np.array([_closest(at, goal, level) for goal in goals]).reshape(len(goals), len(known))
    if q_near is not None:
        near = np.array(q_near, dtype=float)
    elif len(known):
        near = known[order[:, 0]]
    else:
        raise ValueError("without q_near there must be known poses to start from")
    q, miss = _descend(chain, goals, near, level)
    for row in np.flatnonzero(miss >= TOLERANCE):
        for first, end in pairwise((0, *_STARTS)):
            starts = known[order[row, first:end]]
            if not len(starts) or miss[row] < TOLERANCE:
                break
            found, off = _best_of(chain, goals[row], starts, near[row], level)
            if off < miss[row]:
                q[row], miss[row] = found, off
    q[miss >= TOLERANCE * 1e3] = np.nan
    return Reached(q, miss)


def reach_inside(chain: SerialChain, goals: Array, near: Array, ranges: Array, level: bool) -> Reached:
    """Joints for the poses ``goals`` (k, 4, 4) that are within ``ranges`` (j, 2), closest to ``near`` (j,).

    Where no joints inside were found, those that are least far outside; :func:`beyond` tells by how much.
    """
    spread = np.random.default_rng(0).uniform(ranges[:, 0], ranges[:, 1], (_INSIDE[-1] - 1, chain.joints))
    starts = np.vstack([near, spread])
    q, miss = np.full((len(goals), chain.joints), np.nan), np.full(len(goals), np.inf)
    for count in _INSIDE:
        # NaN is inside of nothing
        open_ = np.flatnonzero(~np.all(beyond(q, ranges) == 0.0, axis=1))
        if not len(open_):
            break
        tried, off = _descend(
            chain, np.repeat(goals[open_], count, axis=0), np.tile(starts[:count], (len(open_), 1)), level
        )
        tried = _turned_inside(chain, tried, near, ranges).reshape(len(open_), count, -1)
        off = off.reshape(len(open_), count)
        outside = np.max(np.abs(beyond(tried, ranges)), axis=2)
        away = np.linalg.norm(tried - near, axis=2)
        reached = off < TOLERANCE
        order = np.lexsort((np.where(reached, away, off), np.where(reached, outside, 0.0), ~reached))[:, 0]
        rows = np.arange(len(open_))
        q[open_], miss[open_] = tried[rows, order], off[rows, order]
    q[miss >= TOLERANCE * 1e3] = np.nan
    return Reached(q, miss)


def beyond(q: Array, ranges: Array) -> Array:
    """How far joints ``q`` (..., j) are above (positive) or below ``ranges`` (j, 2); 0 inside."""
    out: Array = q - np.clip(q, ranges[:, 0], ranges[:, 1])
    return out


def _best_of(chain: SerialChain, goal: Array, starts: Array, near: Array, level: bool) -> tuple[Array, float]:
    """The joints closest to ``near`` of those that ``starts`` (m, j) lead to, and how far they miss."""
    tried, off = _descend(chain, np.repeat(goal[None], len(starts), axis=0), starts, level)
    tried = _same_turn(chain, tried, near)
    away = np.where(off < TOLERANCE, np.linalg.norm(tried - near, axis=1), np.inf)
    best = int(np.argmin(away)) if np.any(np.isfinite(away)) else int(np.argmin(off))
    return tried[best], float(off[best])


def _closest(at: Array, goal: Array, level: bool) -> NDArray[np.int64]:
    away = np.linalg.norm(at[:, :3, 3] - goal[:3, 3], axis=1)
    if not level:
        cosine = 0.5 * (np.einsum("nij,ij->n", at[:, :3, :3], goal[:3, :3]) - 1.0)
        away = away + 0.3 * np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.argsort(away).astype(np.int64)


def _same_turn(chain: SerialChain, q: Array, near: Array) -> Array:
    """``q`` (m, j) closest to ``near`` by full turns of the joints that drive one link directly."""
    direct, turn = _turns(chain)
    return np.where(direct, q - np.where(direct, turn, 0.0) * np.round((q - near) / turn), q)


def _turned_inside(chain: SerialChain, q: Array, near: Array, ranges: Array) -> Array:
    """``q`` (m, j) by full turns of such joints within ``ranges`` (j, 2) where that can be had, and of those
    closest to ``near``."""
    direct, turn = _turns(chain)
    lowest, highest = np.ceil((ranges[:, 0] - q) / turn), np.floor((ranges[:, 1] - q) / turn)
    wanted = np.round((near - q) / turn)
    middle = np.round((ranges.mean(axis=1) - q) / turn)  # the least outside where no turn leads inside
    turns = np.where(lowest <= highest, np.clip(wanted, lowest, highest), middle)
    return np.where(direct, q + np.where(direct, turn, 0.0) * np.where(direct, turns, 0.0), q)


def _turns(chain: SerialChain) -> tuple[NDArray[np.bool_], Array]:
    """(j,): the joints that drive one link directly, and how far each goes for a turn of it, rad."""
    gear = np.sum(np.abs(chain.coupling), axis=0)
    drives = np.abs(chain.coupling).argmax(axis=0)
    direct = (np.count_nonzero(chain.coupling, axis=0) == 1) & ~chain.sliding[drives]
    return direct, np.where(direct, _TURN / np.maximum(gear, 1e-12), np.inf)


def _descend(chain: SerialChain, goals: Array, start: Array, level: bool) -> tuple[Array, Array]:
    """Damped Newton steps (Nakamura and Hanafusa 1986) for all goals at once."""
    q = np.array(start, dtype=float)
    best, best_miss = q.copy(), np.full(len(q), np.inf)
    gear = np.maximum(np.max(np.abs(chain.coupling), axis=0), 1e-12)
    for _ in range(_STEPS + 1):
        gap, J = _gap(chain, goals, q, level)
        miss = np.max(np.abs(gap), axis=1)
        better = miss < best_miss
        best[better], best_miss[better] = q[better], miss[better]
        if np.all(best_miss < TOLERANCE):
            break
        J = J / gear  # of what the links turn
        Jt = J.swapaxes(1, 2)
        damping = np.minimum(1e-3, miss**2)[:, None, None] + 1e-14
        dq = (Jt @ np.linalg.solve(J @ Jt + damping * np.eye(J.shape[1]), gap[:, :, None]))[:, :, 0]
        largest = np.max(np.abs(dq), axis=1, keepdims=True)
        q = q + dq * np.minimum(1.0, _LARGEST / np.maximum(largest, 1e-12)) / gear
    return best, best_miss


def _gap(chain: SerialChain, goals: Array, q: Array, level: bool) -> tuple[Array, Array]:
    frames = chain.frames(q)
    T, J = frames[:, -1], chain.jacobians(frames)
    if not level:
        return pose_gap(goals, T), J
    x = T[:, :3, 0]
    turn = yaw_of(goals) - yaw_of(T)
    gap = np.column_stack([goals[:, :3, 3] - T[:, :3, 3], (turn + np.pi) % _TURN - np.pi])
    # heading of the x axis: its velocity is omega x x
    flat = np.maximum(x[:, 0] ** 2 + x[:, 1] ** 2, 1e-12)
    heading = J[:, 5] - x[:, 2, None] * (x[:, 0, None] * J[:, 3] + x[:, 1, None] * J[:, 4]) / flat[:, None]
    return gap, np.concatenate([J[:, :3], heading[:, None]], axis=1)
