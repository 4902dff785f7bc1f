"""How far apart estimates from parts of the data lie: consistency, never accuracy.

Every three adjacent poses of a placement (with wrap-around) give an estimate of X. ``spread_within`` is the
RMS over placements of the standard deviation of these, ``spread_across`` the standard deviation of the
placements' means. Beside each stands its noise floor: the value that a perfect arm would give with the same
poses and corner noise, from the same linear maps. Mean rotations are Karcher means.
Source: the cone-pose method of METHODS section 1; pairs there, triples here, since one pair leaves a freedom.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.normal import gathered, gauss_newton, linearise, normal, own_normal
from calibration.hand_eye.problem import Estimate, Problem
from cell.poses import Array

_RESOLVED = 1.3  # times the floor
_WIDEST = 0.05  # m; a triple whose own uncertainty is wider than this says nothing, not even linearly


@dataclass(frozen=True)
class Placement:
    """Estimates (k, 4, 4) of one placement; ``maps`` (k, n, 6, 6) turn residuals into their changes."""

    group: int
    X: Array
    maps: Array
    cov: Array  # (n, 6, 6) of the residuals for a perfect arm
    skipped: int
    least_squares: Array | None  # X (4, 4) from the placement alone


@dataclass(frozen=True)
class Spread:
    """Standard deviations in metres (3,) and radians, and the floors for a perfect arm."""

    t: Array
    r: float
    floor_t: float
    floor_r: float

    @property
    def t_norm(self) -> float:
        return float(np.linalg.norm(self.t))

    @property
    def resolved(self) -> bool:
        """Whether both figures stand out from what the corners alone would give."""
        return self.t_norm > _RESOLVED * self.floor_t and self.r > _RESOLVED * self.floor_r

    def as_dict(self) -> dict[str, object]:
        """For the result."""
        return {
            "t": self.t.tolist(),
            "t_norm": self.t_norm,
            "r": self.r,
            "floor_t": self.floor_t,
            "floor_r": self.floor_r,
            "resolved": self.resolved,
        }


def placements(problem: Problem, at: Estimate, weight: Array, perfect: Array) -> list[Placement]:
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
        alone = _certain(normal(own, weight[rows]).covariance().own[0])
        start = own.at if alone else Estimate(at.X, at.W[g : g + 1])
        X, maps, skipped = _triples(part, start, weight[rows])
        out.append(Placement(g, X, maps, perfect[rows], skipped, own.at.X if alone else None))
    return out


def _triples(problem: Problem, start: Estimate, weight: Array) -> tuple[Array, Array, int]:
    """X of all triples (k, 4, 4) by one Gauss-Newton step from the common start, and their maps."""
    n = problem.n
    lin = linearise(problem, start)
    JtP = np.swapaxes(lin.J, 1, 2) @ weight
    own, g = own_normal(lin, weight)
    X, maps = [], []
    for i in range(n if n > 3 else 1):
        rows = np.array([i, (i + 1) % n, (i + 2) % n])
        cov = gathered(own[rows], g[rows], problem.group[rows], 1).covariance().own[0]
        if not _certain(cov):
            continue
        gain = -cov[:6] @ JtP[rows]
        step = np.einsum("kab,kb->a", gain, lin.r[rows])
        X.append(start.X @ se3.exp(step))
        K = np.zeros((n, 6, 6))
        K[rows] = gain
        maps.append(K)
    count = n if n > 3 else 1
    if not X:
        return np.zeros((0, 4, 4)), np.zeros((0, n, 6, 6)), count
    return np.stack(X), np.stack(maps), count - len(X)


def _certain(cov: Array) -> bool:
    """Whether the translation of X is known well enough; a singular problem is known along no line at all."""
    full = np.linalg.matrix_rank(cov, tol=1e-12 * np.linalg.norm(cov), hermitian=True) == len(cov)
    return bool(full and np.trace(cov[:3, :3]) < _WIDEST**2)


def spread_within(found: list[Placement]) -> Spread | None:
    """RMS over placements of the standard deviation of their estimates; None without two in any."""
    t2, r2, ft2, fr2 = [], [], [], []
    for p in found:
        k = len(p.X)
        if k < 2:
            continue
        t, r = _deviations(p.X)
        t2.append(np.sum(t**2, axis=0) / (k - 1))
        r2.append(np.sum(r**2) / (k - 1))
        centred = p.maps - p.maps.mean(axis=0)
        cov = np.einsum("knab,nbc,kndc->ad", centred, p.cov, centred, optimize=True) / (k - 1)
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


def spread_across(found: list[Placement]) -> Spread | None:
    """Standard deviation of the placements' means; None with fewer than two placements."""
    usable = [p for p in found if len(p.X)]
    m = len(usable)
    if m < 2:
        return None
    means = np.stack([se3.mean_pose(p.X) for p in usable])
    t, r = _deviations(means)
    floors = []
    for p in usable:
        mean_map = p.maps.mean(axis=0)
        floors.append(np.einsum("nab,nbc,ndc->ad", mean_map, p.cov, mean_map, optimize=True))
    floor = np.mean(floors, axis=0)
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
