"""How far apart estimates from parts of the data lie: consistency, never accuracy.

Every three adjacent poses of a placement (with wrap-around) give an estimate of X. ``spread_within`` is the
RMS over placements of the standard deviation of these, ``spread_across`` the standard deviation of the
placements' means. Beside each stands its noise floor: the value that a perfect arm would give with the same
poses and corner noise, from the same linear maps. Mean rotations are Karcher means.
Source: the cone-pose method of docs/methods.md; pairs there, triples here, since one pair leaves a freedom.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.normal import Normal, gauss_newton, linearise, normal, own_normal
from calibration.hand_eye.problem import Estimate, Problem
from cell.poses import Array

_RESOLVED = 1.3  # times the floor
_WIDEST = 0.05  # m; a triple whose own uncertainty is wider than this says nothing, not even linearly


@dataclass(frozen=True)
class PlacementEstimates:
    """Estimates (k, 4, 4) of one placement, from the poses in ``rows`` (k, 3) of its n.

    ``gains`` (k, 3, 6, 6) turn the residuals of these poses into changes of the estimate.
    """

    group: int
    X: Array
    rows: NDArray[np.int64]
    gains: Array
    cov: Array  # (n, 6, 6) of the residuals for a perfect arm; NaN where that is not known
    skipped: int
    least_squares: Array | None  # X (4, 4) from the placement alone

    def mean_floor(self) -> Array:
        """Covariance (6, 6) of the mean of the estimates for a perfect arm."""
        of_pose = np.zeros((len(self.cov), 6, 6))
        np.add.at(of_pose, self.rows, self.gains / len(self.gains))
        return _carried(of_pose, self.cov)

    def floor(self) -> Array:
        """Covariance (6, 6) of one estimate about their mean for a perfect arm; needs two."""
        k = len(self.gains)
        each = _carried(self.gains.reshape(-1, 6, 6), self.cov[self.rows.ravel()])
        return np.asarray((each - k * self.mean_floor()) / (k - 1))


@dataclass(frozen=True)
class Spread:
    """Standard deviations in metres (3,) and radians, and the floors for a perfect arm: NaN if not known."""

    t: Array
    r: float
    floor_t: float
    floor_r: float

    @property
    def floor_known(self) -> bool:
        return bool(np.isfinite(self.floor_t))

    @property
    def t_norm(self) -> float:
        return float(np.linalg.norm(self.t))

    @property
    def resolved(self) -> bool:
        """Whether both figures stand out from what the measurement alone would give."""
        return self.t_norm > _RESOLVED * self.floor_t and self.r > _RESOLVED * self.floor_r


def placements(problem: Problem, at: Estimate, weight: Array, perfect: Array) -> list[PlacementEstimates]:
    """The estimates of every placement with at least three poses.

    ``weight`` (n, 6, 6) weighs the residuals, ``perfect`` (n, 6, 6) is their covariance with a perfect arm.
    """
    out = []
    for g in range(problem.groups):
        rows = np.flatnonzero(problem.group == g)
        if len(rows) < 3:
            continue
        part = problem.take(rows)
        own = gauss_newton(part, Estimate(at.X, at.W[g : g + 1]), weight[rows], iterations=3)
        alone = _certain(normal(own, weight[rows]).each())[0]
        start = own.at if alone else Estimate(at.X, at.W[g : g + 1])
        X, of, gains = _triples(part, start, weight[rows])
        skipped = _count(len(rows)) - len(X)
        out.append(PlacementEstimates(g, X, of, gains, perfect[rows], skipped, own.at.X if alone else None))
    return out


def _count(n: int) -> int:
    """Number of triples of adjacent poses."""
    return n if n > 3 else 1


def _triples(problem: Problem, start: Estimate, weight: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """X of all triples (k, 4, 4) by one Gauss-Newton step from the common start, their poses and gains."""
    lin = linearise(problem, start)
    JtP = np.swapaxes(lin.J, 1, 2) @ weight
    own, g = own_normal(lin, weight)
    rows = (np.arange(_count(problem.n))[:, None] + np.arange(3)) % problem.n
    cov = Normal(own[rows].sum(axis=1), g[rows].sum(axis=1)).each()
    certain = _certain(cov)
    rows = rows[certain]
    gains = -cov[certain, None, :6] @ JtP[rows]
    steps = np.einsum("ktab,ktb->ka", gains, lin.r[rows])
    return start.X @ se3.exp(steps), rows, gains


def _certain(cov: Array) -> NDArray[np.bool_]:
    """Whether (k,) the translation of X is known well enough by (k, 12, 12); a singular problem is known
    along no line at all."""
    size = np.linalg.norm(cov, axis=(1, 2))
    full = np.linalg.matrix_rank(cov, tol=1e-12 * size, hermitian=True) == cov.shape[1]
    return np.asarray(full & (np.trace(cov[:, :3, :3], axis1=1, axis2=2) < _WIDEST**2))


def _carried(maps: Array, cov: Array) -> Array:
    """Sum of ``M cov M^T`` (6, 6) over (m, 6, 6)."""
    return np.asarray(np.einsum("mab,mbc,mdc->ad", maps, cov, maps, optimize=True))


def spread_within(found: list[PlacementEstimates]) -> Spread | None:
    """RMS over placements of the standard deviation of their estimates; None without two in any."""
    t2, r2, ft2, fr2 = [], [], [], []
    for p in found:
        k = len(p.X)
        if k < 2:
            continue
        t, r = _deviations(p.X)
        t2.append(np.sum(t**2, axis=0) / (k - 1))
        r2.append(np.sum(r**2) / (k - 1))
        cov = p.floor()
        ft2.append(np.trace(cov[:3, :3]))
        fr2.append(np.trace(cov[3:, 3:]))
    if not t2:
        return None
    return Spread(
        np.sqrt(np.mean(t2, axis=0)),
        float(np.sqrt(np.mean(r2))),
        float(np.sqrt(np.mean(ft2))),
        float(np.sqrt(np.mean(fr2))),
    )


def spread_across(found: list[PlacementEstimates]) -> Spread | None:
    """Standard deviation of the placements' means; None with fewer than two placements."""
    usable = [p for p in found if len(p.X)]
    m = len(usable)
    if m < 2:
        return None
    means = np.stack([se3.mean_pose(p.X) for p in usable])
    t, r = _deviations(means)
    floor = np.mean([p.mean_floor() for p in usable], axis=0)
    return Spread(
        np.sqrt(np.sum(t**2, axis=0) / (m - 1)),
        float(np.sqrt(np.sum(r**2) / (m - 1))),
        float(np.sqrt(np.trace(floor[:3, :3]))),
        float(np.sqrt(np.trace(floor[3:, 3:]))),
    )


def _deviations(X: Array) -> tuple[Array, NDArray[np.float64]]:
    """Translations (k, 3) from their mean, and rotation angles (k,) from the Karcher mean."""
    mean = se3.mean_pose(X)
    r = np.linalg.norm(se3.log(se3.inverse(mean) @ X)[:, 3:], axis=1)
    return X[:, :3, 3] - mean[:3, 3], r
