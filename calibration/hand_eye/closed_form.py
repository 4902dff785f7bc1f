"""A first estimate without start values, from relative motions ``A X = X B``.

Rotation by the Kronecker form of ``R_A R_X = R_X R_B`` (Andreff, Horaud and Espiau 2001), translation by
linear least squares, with pairs weighted down by a robust second pass.
"""

import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.problem import Estimate, Groups, Problem
from cell.poses import Array

_MAX_PAIRS = 800


def pairs(group: Groups, limit: int = _MAX_PAIRS) -> tuple[Groups, Groups]:
    """Index pairs (k,), (k,) inside the groups; at most about ``limit``, spread over all strides."""
    first, second = [], []
    order = np.argsort(group, kind="stable")
    _, starts, sizes = np.unique(group[order], return_index=True, return_counts=True)
    for n in np.unique(sizes):  # the groups of one size at once
        rows = order[starts[sizes == n][:, None] + np.arange(n)]
        share = max(1, limit * n // len(group))
        strides = list(range(1, n))
        if n * (n - 1) // 2 > share:
            count = max(1, share // n)
            strides = sorted({max(1, round(k)) for k in np.linspace(1, n - 1, count)})
        for s in strides:
            first.append(rows[:, : n - s].ravel())
            second.append(rows[:, s:].ravel())
    if not first:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return np.concatenate(first), np.concatenate(second)


def closed_form(problem: Problem) -> Estimate:
    """X from all motions inside the groups, each W as the median of what its observations say."""
    X = closed_form_X(problem)
    return Estimate(X, group_poses(problem, X))


def closed_form_X(problem: Problem) -> Array:
    """X (4, 4) alone, from all motions inside the groups."""
    i, j = pairs(problem.group)
    A = problem.G[i] @ se3.inverse(problem.G[j])
    B = problem.C[i] @ se3.inverse(problem.C[j])
    X = _solve(A, B, np.ones(len(i)))
    for _ in range(2 if len(i) else 0):
        error = A @ X - X @ B
        turn = np.sqrt(np.sum(error[:, :3, :3] ** 2, axis=(1, 2)))
        shift = np.sqrt(np.sum(error[:, :3, 3] ** 2, axis=1))
        distance = turn / (_median(turn) + 1e-9) + shift / (_median(shift) + 1e-9)
        X = _solve(A, B, 1.0 / (1.0 + (distance / 4.0) ** 4))
    return X


def group_poses(problem: Problem, X: Array) -> Array:
    """W (g, 4, 4): per group the observation that agrees best with all others of the group."""
    own = problem.target_poses(X)
    out = np.zeros((problem.groups, 4, 4))
    for g in range(problem.groups):
        T = own[problem.group == g]
        entries = (T[:, :3] - T[0, :3]).reshape(-1, 12)
        some = entries[:: max(1, len(T) // 32)]
        squares = np.vecdot(entries, entries)[:, None] + np.vecdot(some, some) - 2.0 * entries @ some.T
        out[g] = T[int(np.argmin(_median(np.sqrt(np.maximum(squares, 0.0)))))]
    return out


def _median(values: Array) -> Array:
    """Medians (...) of (..., n): np.median takes twice as long, and looks for numbers that are none."""
    middle = [(values.shape[-1] - 1) // 2, values.shape[-1] // 2]
    return np.asarray(np.partition(values, middle, axis=-1)[..., middle].mean(axis=-1))


def _solve(A: Array, B: Array, weight: Array) -> Array:
    RA, RB = A[:, :3, :3], B[:, :3, :3]
    eye, total = np.eye(3), weight.sum()
    # vec(RA R) = (I kron RA) vec(R), vec(R RB) = (RB^T kron I) vec(R), vec by columns; with rotations the
    # squares of their differences add up to 2 I less RB kron RA and its transpose
    cross = (weight[:, None] * RB.reshape(-1, 9)).T @ RA.reshape(-1, 9)
    cross = cross.reshape(3, 3, 3, 3).transpose(0, 2, 1, 3).reshape(9, 9)
    M = 2.0 * total * np.eye(9) - cross - cross.T
    R = np.linalg.eigh(M)[1][:, 0].reshape(3, 3).T
    U, _, Vt = np.linalg.svd(R * np.sign(np.linalg.det(R)))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    b = weight[:, None] * (B[:, :3, 3] @ R.T - A[:, :3, 3])
    turned = (weight @ RA.reshape(-1, 9)).reshape(3, 3)
    normal = 2.0 * total * eye - turned - turned.T  # the squares of RA - I
    t = np.linalg.lstsq(normal, np.tensordot(b, RA, axes=2) - b.sum(axis=0), rcond=None)[0]
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, t
    return X
