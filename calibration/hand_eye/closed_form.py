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
    for g in np.unique(group):
        rows = np.flatnonzero(group == g)
        n = len(rows)
        share = max(1, limit * n // len(group))
        strides = list(range(1, n))
        if n * (n - 1) // 2 > share:
            count = max(1, share // n)
            strides = sorted({max(1, round(k)) for k in np.linspace(1, n - 1, count)})
        for s in strides:
            first.append(rows[: n - s])
            second.append(rows[s:])
    if not first:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return np.concatenate(first), np.concatenate(second)


def closed_form(problem: Problem) -> Estimate:
    """X from all motions inside the groups, each W as the median of what its observations say."""
    i, j = pairs(problem.group)
    A = problem.G[i] @ se3.inverse(problem.G[j])
    B = problem.C[i] @ se3.inverse(problem.C[j])
    weight = np.ones(len(i))
    X = np.eye(4)
    for _ in range(3):
        X = _solve(A, B, weight)
        error = A @ X - X @ B
        turn = np.linalg.norm(error[:, :3, :3], axis=(1, 2))
        shift = np.linalg.norm(error[:, :3, 3], axis=1)
        distance = turn / (np.median(turn) + 1e-9) + shift / (np.median(shift) + 1e-9)
        weight = 1.0 / (1.0 + (distance / 4.0) ** 4)
    return Estimate(X, group_poses(problem, X))


def group_poses(problem: Problem, X: Array) -> Array:
    """W (g, 4, 4): per group the observation that agrees best with all others of the group."""
    own = problem.target_poses(X)
    out = np.zeros((problem.groups, 4, 4))
    for g in range(problem.groups):
        T = own[problem.group == g]
        some = T[:: max(1, len(T) // 32)]
        apart = np.linalg.norm(T[:, None, :3] - some[None, :, :3], axis=(2, 3))
        middle = [(apart.shape[1] - 1) // 2, apart.shape[1] // 2]
        median = np.partition(apart, middle, axis=1)[:, middle].mean(axis=1)  # np.median takes twice as long
        out[g] = T[int(np.argmin(median))]
    return out


def _solve(A: Array, B: Array, weight: Array) -> Array:
    RA, RB = A[:, :3, :3], B[:, :3, :3]
    eye = np.eye(3)
    # vec(RA R) = (I kron RA) vec(R), vec(R RB) = (RB^T kron I) vec(R), vec by columns
    left = np.einsum("ab,ncd->nacbd", eye, RA).reshape(-1, 9, 9)
    right = np.einsum("nba,cd->nacbd", RB, eye).reshape(-1, 9, 9)
    K = left - right
    M = np.tensordot(weight, np.swapaxes(K, 1, 2) @ K, axes=1)
    R = np.linalg.eigh(M)[1][:, 0].reshape(3, 3).T
    U, _, Vt = np.linalg.svd(R * np.sign(np.linalg.det(R)))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    S = RA - eye
    b = B[:, :3, 3] @ R.T - A[:, :3, 3]
    St = np.swapaxes(S, 1, 2)
    normal = np.tensordot(weight, St @ S, axes=1)
    t = np.linalg.lstsq(normal, np.tensordot(weight, (St @ b[..., None])[..., 0], axes=1), rcond=None)[0]
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, t
    return X
