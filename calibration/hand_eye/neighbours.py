"""The classic cone method: unweighted AX = XB on neighbours on the cone, their means and spreads.

Every three neighbours of a placement (with wrap-around) give an estimate of X from their three relative
motions: the rotation by quaternions (Horaud and Dornaika 1995), the translation by linear least squares.
Nothing is weighted and nothing is left out as a blunder, so these figures may be held against those that
are published for the method. Those of :mod:`calibration.hand_eye.spread` are of weighted estimates, and
smaller.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye import se3
from calibration.hand_eye.problem import Problem
from cell.poses import Array

WIDEST_M = 1.0  # estimates that lie farther apart do not tell where a camera is
_SINGULAR = 1e-9  # of the largest singular value: such motions share an axis, and X has a freedom


@dataclass(frozen=True)
class NeighbourEstimates:
    """Estimates ``X`` (k, 4, 4) of one placement, from the poses ``rows`` (k, 3) of the problem.

    ``least_squares`` (4, 4) is the estimate from all motions between neighbours at once.
    """

    group: int
    X: Array
    rows: NDArray[np.int64]
    skipped: int
    least_squares: Array | None

    def mean(self, least_squares: bool = False) -> Array | None:
        """(4, 4); by Karcher mean of the rotations and arithmetic mean of the places, or by least squares."""
        if least_squares:
            return self.least_squares
        return se3.mean_pose(self.X) if len(self.X) else None


@dataclass(frozen=True)
class Deviation:
    """Standard deviation: along the axes ``t`` (3,) m, and of the rotation ``r`` rad."""

    t: Array
    r: float

    @property
    def too_wide(self) -> bool:
        return bool(np.linalg.norm(self.t) > WIDEST_M)


def neighbour_estimates(problem: Problem, place: NDArray[np.int64]) -> list[NeighbourEstimates]:
    """Of every placement with at least three poses; ``place`` (n,) orders the poses of each on its cone."""
    found = []
    for g in range(problem.groups):
        rows = np.flatnonzero(problem.group == g)
        rows = rows[np.argsort(place[rows], kind="stable")]
        n = len(rows)
        if n < 3:
            continue
        triples = rows[(np.arange(n if n > 3 else 1)[:, None] + np.arange(3)) % n]
        X, sure = solve_motions(*_motions(problem, triples[:, [0, 0, 1]], triples[:, [1, 2, 2]]))
        pairs = np.unique(np.sort(triples[:, [0, 1, 0, 2, 1, 2]].reshape(-1, 2), axis=1), axis=0)
        every, told = solve_motions(*_motions(problem, pairs[None, :, 0], pairs[None, :, 1]))
        found.append(
            NeighbourEstimates(g, X[sure], triples[sure], int(np.sum(~sure)), every[0] if told[0] else None)
        )
    return found


def _motions(problem: Problem, first: NDArray[np.int64], second: NDArray[np.int64]) -> tuple[Array, Array]:
    """From the first poses to the second, as OpenCV has them; with noise the inverse ones differ."""
    G, C = problem.G, problem.C
    return G[second] @ se3.inverse(G[first]), C[second] @ se3.inverse(C[first])


def solve_motions(A: Array, B: Array) -> tuple[Array, NDArray[np.bool_]]:
    """X (k, 4, 4) with ``A X = X B`` in the sense of least squares for the motions (k, m, 4, 4) of each, and
    where (k,) they determine it."""
    a, b = _vectors(A), _vectors(B)
    U, _, Vt = np.linalg.svd(np.swapaxes(a, 1, 2) @ b)
    flip = np.ones((len(A), 3))
    flip[:, 2] = np.linalg.det(U @ Vt)
    R = (U * flip[:, None, :]) @ Vt
    S = (A[..., :3, :3] - np.eye(3)).reshape(len(A), -1, 3)
    d = (np.einsum("kab,kmb->kma", R, B[..., :3, 3]) - A[..., :3, 3]).reshape(len(A), -1)
    size = np.linalg.svd(a, compute_uv=False), np.linalg.svd(S, compute_uv=False)
    sure = (size[0][:, 1] > _SINGULAR) & (size[1][:, 2] > _SINGULAR * size[1][:, 0])
    X = np.tile(np.eye(4), (len(A), 1, 1))
    X[:, :3, :3] = R
    X[:, :3, 3] = np.einsum("kam,km->ka", np.linalg.pinv(S), d)
    return X, np.asarray(sure)


def _vectors(T: Array) -> Array:
    """Axis times the sine of half the angle (k, m, 3)."""
    q = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.asarray(q[:, :3].reshape(*T.shape[:2], 3))


def within(found: Sequence[NeighbourEstimates]) -> Deviation | None:
    """RMS over placements of the standard deviation of their estimates; None without two in any."""
    each = [_deviation(p.X) for p in found if len(p.X) > 1]
    if not each:
        return None
    t = np.sqrt(np.mean([d.t**2 for d in each], axis=0))
    return Deviation(t, float(np.sqrt(np.mean([d.r**2 for d in each]))))


def across(found: Sequence[NeighbourEstimates], least_squares: bool = False) -> Deviation | None:
    """Standard deviation of the placements' means; None with fewer than two."""
    means = [mean for p in found if (mean := p.mean(least_squares)) is not None]
    return _deviation(np.stack(means)) if len(means) > 1 else None


def mean_of_means(found: Sequence[NeighbourEstimates], least_squares: bool = False) -> Array | None:
    """X (4, 4) of the method; None when no placement has an estimate."""
    means = [mean for p in found if (mean := p.mean(least_squares)) is not None]
    return se3.mean_pose(np.stack(means)) if means else None


def _deviation(X: Array) -> Deviation:
    mean, k = se3.mean_pose(X), len(X)
    t = np.sqrt(np.sum((X[:, :3, 3] - mean[:3, 3]) ** 2, axis=0) / (k - 1))
    r = np.linalg.norm(se3.log(se3.inverse(mean) @ X)[:, 3:], axis=1)
    return Deviation(t, float(np.sqrt(np.sum(r**2) / (k - 1))))
