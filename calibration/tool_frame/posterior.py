"""Mean and covariance under the likelihood of intervals.

Each edge is somewhere in its interval with equal probability, but for a little normal noise: its likelihood
is ``Phi((high - u)/s) - Phi((low - u)/s)``. The places ``e_k`` of the tool's edges are integrated out by
quadrature, each by itself, as they are independent once the rest is given. The rest, few unknowns, is
integrated by importance sampling at quasi-random points (Sobol), the same in every call. The noise is
unknown: it is lowered by steps, the cloud of one step proposes the points of the next, and the steps are
averaged by their evidence. ``effective`` points tell how exact that is: the mean is off by about
``1/sqrt(effective)`` of a standard deviation, less for quasi-random points.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from calibration.tool_frame.averaging import Fit
from calibration.tool_frame.system import Model, Rows
from cell.poses import Array

MIN_SIGMA_M = 2e-7
_BLUNDER = 1e-4  # chance that an edge is anywhere within its beam's range
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_TAIL = 4.0
_USUAL_NOISE_M = 8e-6
_WIDEN = 1.15
_FAR = 7.0


@dataclass(frozen=True, eq=False)
class Posterior:
    """``mean`` (d + m,) and ``cov`` of the unknowns and then the edges' places.

    ``sigma`` (m) is the noise that the data speak for, ``effective`` the number of independent points that
    the averages are worth.
    """

    mean: Array
    cov: Array
    sigma: float
    effective: float

    def psi(self, d: int) -> Array:
        """(d,) mean of the unknowns without the edges."""
        return self.mean[:d]


def posterior(
    rows: Rows,
    model: Model,
    start: Fit,
    noise: float,
    points: int = 2048,
    known_noise: float | None = None,
) -> Posterior:
    """``start`` is the solution by averaging, ``noise`` (m) what it shows beyond the intervals' widths.

    ``known_noise`` (m) when the noise need not be found.
    """
    d = rows.X.shape[1]
    width = float(np.median(rows.width))
    sigmas = _ladder(width, noise)
    if known_noise is not None:
        sigmas = [*(s for s in sigmas if s > known_noise), known_noise]
    mean, cov = start.psi, start.cov[:d, :d] * 1.5
    likelihood = _Likelihood(rows, model)
    steps: list[tuple[float, float, Array, Array]] = []
    best = -np.inf
    pilot = max(points // 4, 128)
    for k, sigma in enumerate(sigmas):
        for _ in range(2 if k == 0 else 1):
            cloud = likelihood.sample(mean, cov, sigma, pilot)
            if cloud.effective < 0.03 * pilot:
                cloud = likelihood.sample(cloud.mean[:d], 1.3 * cloud.cov[:d, :d] + 0.1 * cov, sigma, pilot)
            mean, cov = cloud.mean[:d], cloud.cov[:d, :d]
        evidence = cloud.evidence + _noise_prior(sigma, width)
        steps.append((sigma, evidence, mean, cov))
        best = max(best, evidence)
        if evidence < best - 8.0 and known_noise is None:
            break
    chosen = [s for s in steps if s[1] > best - 3.5] if known_noise is None else steps[-1:]
    count = points if len(chosen) < 3 else points // 2
    clouds = [likelihood.sample(m, c, s, count) for s, _, m, c in chosen]
    log = np.array([c.evidence + _noise_prior(s[0], width) for c, s in zip(clouds, chosen, strict=True)])
    share = np.exp(log - np.max(log))
    share /= share.sum()
    total = sum(s * c.mean for s, c in zip(share, clouds, strict=True))
    spread = sum(
        s * (c.cov + np.outer(c.mean - total, c.mean - total)) for s, c in zip(share, clouds, strict=True)
    )
    sigma = float(np.sum(share * np.array([s[0] for s in chosen])))
    # What the arm repeats badly shifts all edges of a pass together, which are then worth one and not two;
    # and noise that few edges tell is itself uncertain.
    together = 1.0 + sigma / float(np.hypot(sigma, width / np.sqrt(12.0)))
    effective = float(np.sum(share * np.array([c.effective for c in clouds])))
    return Posterior(np.asarray(total), together * np.asarray(spread), sigma, effective)


def _noise_prior(sigma: float, width: float) -> float:
    """Logarithm of how likely ``sigma`` is before the data: an arm repeats a short way within some
    micrometres, and little data must not be taken for noise. Many edges say what it is whatever this says."""
    return -float(np.log1p((sigma / max(0.15 * width, _USUAL_NOISE_M)) ** 2))


def _ladder(width: float, noise: float) -> list[float]:
    top = max(0.5 * width, 2.0 * noise, 4.0 * MIN_SIGMA_M)
    found, sigma = [], top
    while sigma > max(0.008 * width, MIN_SIGMA_M):
        found.append(sigma)
        sigma *= 0.5
    return [*found, max(0.008 * width, MIN_SIGMA_M)]


@dataclass(frozen=True, eq=False)
class _Cloud:
    mean: Array
    cov: Array
    evidence: float
    effective: float


class _Likelihood:
    def __init__(self, rows: Rows, model: Model) -> None:
        self.rows = rows
        self.sd, self.trust = model.prior_sd, model.trust
        self.range = max(float(np.ptp(rows.middle)), float(np.max(rows.width)))
        self.own = [np.flatnonzero(rows.edge == k) for k in range(len(rows.labels))]

    def sample(self, mean: Array, cov: Array, sigma: float, points: int) -> _Cloud:
        """Importance sampling from a normal proposal, a little wider than ``cov``."""
        d = len(mean)
        normal = _normal_points(d, points)
        scale = np.sqrt(np.diag(cov))
        root = scale[:, None] * np.linalg.cholesky(cov / np.outer(scale, scale) + 1e-12 * np.eye(d))
        psi = mean + _WIDEN * normal @ root.T
        log_weight, e_mean, e_var = self._log(psi, mean, cov, sigma)
        log_weight += 0.5 * np.sum(normal**2, axis=1)
        top = float(np.max(log_weight))
        weight = np.exp(log_weight - top)
        total = float(np.sum(weight))
        evidence = top + np.log(total / points) + float(np.sum(np.log(np.abs(np.diag(root)) * _WIDEN)))
        weight /= total
        both = np.hstack([psi, e_mean])
        centre = weight @ both
        off = both - centre
        spread = (off.T * weight) @ off
        spread[np.arange(d, len(centre)), np.arange(d, len(centre))] += weight @ e_var
        effective = 1.0 / float(weight @ weight)
        if effective < 3.0 * d:  # too few to tell a covariance: keep most of the proposal's
            share = effective / (3.0 * d)
            spread[:d, :d] = share * spread[:d, :d] + (1.0 - share) * cov
        return _Cloud(centre, spread, evidence, effective)

    def _log(self, psi: Array, mean: Array, cov: Array, sigma: float) -> tuple[Array, Array, Array]:
        log = -0.5 * np.sum((psi / self.sd) ** 2, axis=1)
        trusted = np.isfinite(self.trust)
        log -= np.sum(np.log1p((psi[:, trusted] / self.trust[trusted]) ** 2), axis=1)
        e_mean, e_var = np.zeros((len(psi), len(self.own))), np.zeros((len(psi), len(self.own)))
        for k, own in enumerate(self.own):
            value, e_mean[:, k], e_var[:, k] = self._edge(own, psi, mean, cov, sigma)
            log += value
        return log, e_mean, e_var

    def _edge(
        self, own: NDArray[np.int64], psi: Array, mean: Array, cov: Array, sigma: float
    ) -> tuple[Array, Array, Array]:
        """Logarithm of the integral over one edge's place, with the mean and variance of that place."""
        rows = self.rows
        s = np.sqrt(rows.soft[own] ** 2 + sigma**2)
        low, high = rows.low[own] - rows.X[own] @ mean, rows.high[own] - rows.X[own] @ mean
        # Bounds that cannot matter anywhere in the cloud are left out.
        X = rows.X[own]
        loosest = X[int(np.argmin(high - low))]
        spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", X - loosest, cov, X - loosest), 0.0))
        reach = _FAR * s + 4.0 * spread
        matters = (low + reach > np.max(low - reach)) | (high - reach < np.min(high + reach))
        move = (psi - mean) @ X[matters].T
        low, high, s = low[matters] - move, high[matters] - move, s[matters]
        a, b = np.max(low, axis=1), np.min(high, axis=1)
        begin = np.minimum(a, b) - _TAIL * np.max(s)
        half = 0.5 * (np.maximum(a, b) + _TAIL * np.max(s) - begin)
        e = (begin + half)[:, None] + half[:, None] * _NODES
        density = np.ones_like(e)
        floor = _BLUNDER / self.range
        for j in range(len(s)):
            inside = _phi((high[:, j, None] - e) / s[j]) - _phi((low[:, j, None] - e) / s[j])
            width = float(high[0, j] - low[0, j])
            density *= (1.0 - _BLUNDER) * inside / width + floor
            if j % 8 == 7:
                density = np.maximum(density, 1e-290)
            density *= width
        weighted = density * _WEIGHTS
        total = np.maximum(np.sum(weighted, axis=1), 1e-300)
        centre = np.sum(weighted * e, axis=1) / total
        var = np.sum(weighted * (e - centre[:, None]) ** 2, axis=1) / total
        return np.log(total * half), centre, var


def _phi(x: Array) -> Array:
    """The normal distribution to 3e-4, ten times as fast: noise is not normal to more than that."""
    return 0.5 * np.tanh(0.7978845608 * (x + 0.044715 * x * x * x))  # differences only: 0.5 is left out


_cache: dict[tuple[int, int], Array] = {}


def _normal_points(d: int, points: int) -> Array:
    """(points, d) standard normal quasi-random points, always the same."""
    key = (d, points)
    if key not in _cache:
        exponent = int(np.ceil(np.log2(points)))
        uniform = qmc.Sobol(d, scramble=True, rng=np.random.default_rng(20011)).random_base2(exponent)[
            :points
        ]
        _cache[key] = ndtri(np.clip(uniform, 1e-12, 1.0 - 1e-12))
    return _cache[key]
