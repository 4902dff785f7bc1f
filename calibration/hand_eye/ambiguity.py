"""Which of several poses of an observation is the true one: the arm's motion decides.

A chessboard turned by half a turn, or a planar target mirrored in the line of sight, gives an image that fits
as well. Across poses only one choice agrees with the arm: relative rotations have the angle of the arm's,
whatever X is. That gives a start; then solving and choosing alternate until no choice changes.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.closed_form import closed_form
from calibration.hand_eye.pnp import Poses
from calibration.hand_eye.problem import Groups, Problem, Setup
from cell.poses import Array

Choice = NDArray[np.int64]
_ANCHORS = 8


def turns(points: Array, symmetries: Sequence[NDArray[np.int64]]) -> Array:
    """The (k, 4, 4) rigid motions of the target that each renumbering of its points stands for.

    Corner i called point i although it is point s[i] means a pose ``C T^-1`` with ``T p_i = p_s[i]``.
    """
    out = np.tile(np.eye(4), (len(symmetries), 1, 1))
    centre = points.mean(axis=0)
    for k, renumbered in enumerate(symmetries):
        moved = points[renumbered]
        U, _, Vt = np.linalg.svd((moved - centre).T @ (points - centre))
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        out[k, :3, :3], out[k, :3, 3] = R, centre - R @ centre
    return out


def candidates(poses: Poses, owner: Groups, motions: Array) -> tuple[Array, Choice]:
    """All poses (n, k, 4, 4) an observation may have, and which of ``poses`` each (n, k) comes from.

    Observations with fewer than k repeat their first.
    """
    n = int(owner.max()) + 1
    starts = np.searchsorted(owner, np.arange(n))
    counts = np.bincount(owner, minlength=n)
    most = int(counts.max())
    rows = starts[:, None] + np.minimum(np.arange(most), counts[:, None] - 1)
    rows = np.where(np.arange(most) < counts[:, None], rows, starts[:, None])
    C = poses.C[rows][:, :, None] @ se3.inverse(motions)[None, None]
    return C.reshape(n, -1, 4, 4), np.repeat(rows, len(motions), axis=1)


def choose(setup: Setup, G: Array, group: Groups, C: Array) -> Choice:
    """The candidate (n,) of each observation on which the arm and the camera agree best; C is (n, k, 4, 4).

    The first observation of a group keeps its target frame as it is: turning the target in all images of a
    group at once changes nothing that can be measured.
    """
    n, k = C.shape[:2]
    if k == 1:
        return np.zeros(n, dtype=np.int64)
    best, best_cost = np.zeros(n, dtype=np.int64), np.inf
    for anchor in range(min(_ANCHORS, n)):
        start = _by_angles(G, group, C, anchor)
        choice, cost = _alternate(setup, G, group, C, start)
        if cost < 0.98 * best_cost:
            best, best_cost = choice, cost
    return best


def _by_angles(G: Array, group: Groups, C: Array, anchor: int) -> Choice:
    """Each candidate judged by the rotation angles to the anchors of its group, two passes."""
    choice = np.zeros(len(C), dtype=np.int64)
    for g in np.unique(group):
        rows = np.flatnonzero(group == g)
        a = rows[anchor * len(rows) // _ANCHORS]
        for reference in ([a], rows):
            known = np.array(reference)[:: max(1, len(reference) // 24)]
            arm = _angles(G[rows][:, None, None], G[known][None, None])
            camera = _angles(C[rows][:, :, None], C[known, choice[known]][None, None])
            choice[rows] = np.argmin(np.minimum(np.abs(arm - camera), 0.5).sum(axis=2), axis=1)
            choice[a] = 0 if len(reference) == 1 else choice[a]
    return choice


def _angles(A: Array, B: Array) -> Array:
    """Angle of A B^-1; the trace is the sum over all entries of the product of the two rotations."""
    trace = np.sum(A[..., :3, :3] * B[..., :3, :3], axis=(-1, -2))
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))


def _alternate(setup: Setup, G: Array, group: Groups, C: Array, choice: Choice) -> tuple[Choice, float]:
    n = len(G)
    everyone = np.arange(n)
    cost = np.inf
    for _ in range(12):
        problem = _bare(setup, G, group, C[everyone, choice])
        at = closed_form(problem)
        target = at.W[group][:, None]
        own = se3.inverse(G)[:, None] @ at.X @ C
        turn = np.linalg.norm(own[..., :3, :3] - target[..., :3, :3], axis=(-1, -2))
        reach = np.linalg.norm(C[..., :3, 3], axis=-1)
        shift = np.linalg.norm(own[..., :3, 3] - target[..., :3, 3], axis=-1) / reach
        miss = np.minimum(turn + shift, 1.0)
        again = np.argmin(miss, axis=1)
        cost = float(miss[everyone, again].sum())
        if np.array_equal(again, choice):
            break
        choice = again
    return choice, cost


def _bare(setup: Setup, G: Array, group: Groups, C: Array) -> Problem:
    n = len(G)
    _, numbered = np.unique(group, return_inverse=True)
    return Problem(setup, G, C, numbered.astype(np.int64), np.zeros((n, 6, 6)), np.zeros(n), np.zeros(n))
