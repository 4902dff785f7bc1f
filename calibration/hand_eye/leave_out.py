"""Solutions that did not see some of the data: the held-out check, without solving again.

At the solution the problem is linear to second order, so taking observations out of the normal equations
and taking one Gauss-Newton step gives the solution without them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.normal import (
    Linearised,
    Normal,
    gathered,
    normal,
    own_normal,
    pseudo_inverse,
    row_blocks,
)
from cell.poses import Array

FOLDS = 5


@dataclass(frozen=True)
class LeftOut:
    """Distance of each judged observation's target pose from the one predicted without it.

    ``rows`` (k,) are the observations, ``t`` (k,) metres and ``r`` (k,) radians.
    """

    rows: NDArray[np.int64]
    t: Array
    r: Array

    def means(self) -> dict[str, float]:
        """Mean distances; empty when nothing could be judged."""
        return {"t": float(self.t.mean()), "r": float(self.r.mean())} if len(self.rows) else {}

    def rms(self) -> dict[str, float]:
        """Root mean square distances; empty when nothing could be judged."""
        if not len(self.rows):
            return {}
        return {"t": float(np.sqrt(np.mean(self.t**2))), "r": float(np.sqrt(np.mean(self.r**2)))}


_NONE = LeftOut(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))


def leave_one_out(lin: Linearised, weight: Array) -> LeftOut:
    """Each observation judged by the solution from all the others.

    Only its own group changes with it: the others are added up once, so the cost grows with n alone.
    """
    problem = lin.problem
    size = np.bincount(problem.group, minlength=problem.groups)
    rows = np.flatnonzero(size[problem.group] > 1)
    if not len(rows) or 6 * (problem.n - 1) < 6 + 6 * problem.groups + 6:
        return _NONE
    everything = normal(lin, weight)
    others = everything.eliminated
    schur_of_others, gradient_of_others = _all_but_one(others.schur), _all_but_one(others.gradient)
    t, r = np.empty(len(rows)), np.empty(len(rows))
    for some in row_blocks(len(rows)):
        left = rows[some]
        group = problem.group[left]
        own, g = own_normal(lin, weight, left)
        rest = Normal(everything.own[group] - own, everything.g[group] - g)
        part = rest.eliminated
        schur = part.schur + schur_of_others[group]
        gradient = part.gradient + gradient_of_others[group]
        x = (pseudo_inverse(schur) @ gradient[..., None])[..., 0]
        w = (part.inverse @ rest.g[:, 6:, None] - part.carry @ x[..., None])[..., 0]
        mine = se3.inverse(problem.G[left]) @ (lin.at.X @ se3.exp(-x)) @ problem.C[left]
        t[some], r[some] = pose_distances(mine, lin.at.W[group] @ se3.exp(-w))
    return LeftOut(rows, t, r)


def _all_but_one(parts: Array) -> Array:
    """Sum (g, ...) of all parts but each, without a difference that would leave rounding."""
    zero = np.zeros_like(parts[:1])
    before = np.cumsum(np.concatenate([zero, parts[:-1]]), axis=0)
    after = np.cumsum(np.concatenate([zero, parts[:0:-1]]), axis=0)[::-1]
    return np.asarray(before + after)


def held_out(lin: Linearised, weight: Array) -> LeftOut:
    """K-fold check: observations are dealt to the folds in turn, group by group."""
    order = np.argsort(lin.problem.group, kind="stable")
    fold = np.empty(lin.problem.n, dtype=np.int64)
    fold[order] = np.arange(lin.problem.n) % FOLDS
    return leave_out(lin, weight, [np.flatnonzero(fold == k) for k in range(FOLDS)])


def by_placement(lin: Linearised, weight: Array) -> LeftOut:
    """Each placement of the target judged by X from the others: its poses from the mean of its other ones.

    Poses dealt in turn leave a placement in every part: an arm's error there is in solution and judgement.
    """
    problem = lin.problem
    own, g = own_normal(lin, weight)
    everything = gathered(own, g, problem.group, problem.groups)
    rows, t, r = [], [], []
    for k in range(problem.groups if problem.groups > 1 else 0):
        part = np.flatnonzero(problem.group == k)
        if len(part) < 2 or 6 * (problem.n - len(part)) < 6 + 6 * (problem.groups - 1) + 6:
            continue
        out = gathered(own[part], g[part], problem.group[part], problem.groups)
        at = lin.at.moved(-(everything - out).solve())
        mine = se3.inverse(problem.G[part]) @ at.X @ problem.C[part]
        share = len(part) / (len(part) - 1.0)  # a mean that has the pose itself in it is nearer to it
        distance = pose_distances(mine, se3.mean_pose(mine))
        rows.append(part)
        t.append(share * distance[0])
        r.append(share * distance[1])
    if not rows:
        return _NONE
    return LeftOut(np.concatenate(rows), np.concatenate(t), np.concatenate(r))


def leave_out(lin: Linearised, weight: Array, parts: Sequence[NDArray[np.int64]]) -> LeftOut:
    """Judge each part by the solution without it; observations whose group is lost with it are skipped."""
    problem = lin.problem
    own, g = own_normal(lin, weight)
    everything = gathered(own, g, problem.group, problem.groups)
    size = np.bincount(problem.group, minlength=problem.groups)
    rows, t, r = [], [], []
    for part in parts:
        left = size - np.bincount(problem.group[part], minlength=problem.groups)
        judged = part[left[problem.group[part]] > 0]
        rest = problem.n - len(part)
        if not len(judged) or 6 * rest < 6 + 6 * np.count_nonzero(left) + 6:
            continue
        out = gathered(own[part], g[part], problem.group[part], problem.groups)
        at = lin.at.moved(-(everything - out).solve())
        mine = se3.inverse(problem.G[judged]) @ at.X @ problem.C[judged]
        distance = pose_distances(mine, at.W[problem.group[judged]])
        rows.append(judged)
        t.append(distance[0])
        r.append(distance[1])
    if not rows:
        return _NONE
    return LeftOut(np.concatenate(rows), np.concatenate(t), np.concatenate(r))


def pose_distances(A: Array, B: Array) -> tuple[Array, Array]:
    """Distances in metres and radians between poses (n, 4, 4) and (n, 4, 4) or (4, 4)."""
    xi = se3.log(se3.inverse(B) @ A)
    return (
        np.linalg.norm(A[..., :3, 3] - B[..., :3, 3], axis=-1),
        np.linalg.norm(xi[..., 3:], axis=-1),
    )


def spread_about_mean(T: Array, group: NDArray[np.int64]) -> tuple[Array, Array]:
    """Distances (n,) in metres and radians of target poses (n, 4, 4) from the mean of their group."""
    t, r = np.zeros(len(T)), np.zeros(len(T))
    for g in np.unique(group):
        rows = group == g
        t[rows], r[rows] = pose_distances(T[rows], se3.mean_pose(T[rows]))
    return t, r
