"""Scales that the same data tell: noise levels by restricted maximum likelihood, a prior's by evidence.

Both are variance components. The score of a noise level compares its residuals with what the fit leaves of
them, the score of a prior's scale compares the estimates with what the prior lets them be; a component that
was given, or that has no degree of freedom, does not move. A scale by evidence keeps a wide prior of its
own, so that a few weak unknowns do not decide that there is nothing wrong.
Source: Patterson and Thompson 1971; Searle, Casella and McCulloch, Variance Components, ch. 6; MacKay 1992.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.adjustment.equations import Equations, Observations, Prior, equations
from calibration.hand_eye.noise import scores_of_noise
from calibration.hand_eye.normal import row_blocks
from cell.poses import Array

SCALE_FACTOR = 3.0  # a scale by evidence lies within this factor of one at one standard deviation
_LONGEST = 1.5  # of a step in the logarithm of a variance
_FLOOR = {"sigma_px": 1e-3}
_SETTLED = 1e-2  # of the log-likelihood
_SMALLEST = 1e-7
_SMALLEST_SCALE = 1e-2


@dataclass(frozen=True)
class Components:
    """``sigma``: noise levels by name, in the order of the observations' parts; ``scale`` of the blocks.

    ``free`` names those that the data decide, ``most`` holds the largest plausible ones of them and ``least``
    the smallest. ``of_sums`` is the level of what the observations hold as sums.
    """

    sigma: Mapping[str, float]
    scale: Mapping[str, float]
    free: frozenset[str]
    most: Mapping[str, float] = field(default_factory=dict)
    least: Mapping[str, float] = field(default_factory=dict)
    of_sums: str = "sigma_px"

    def variances(self, parts: Array) -> Array:
        """V (n, d, d)."""
        return np.tensordot(np.array([s**2 for s in self.sigma.values()]), parts, axes=1)

    @property
    def variance_of_sums(self) -> float:
        return self.sigma.get(self.of_sums, 1.0) ** 2

    def equations(self, obs: Observations, prior: Prior, at: Array) -> Equations:
        return equations(
            obs, self.variances(obs.parts), self.variance_of_sums, prior.scaled(dict(self.scale)), at
        )


def estimated(
    obs: Observations, prior: Prior, at: Array, start: Components, iterations: int = 30
) -> Components:
    """The free components at the maximum of their restricted likelihood, from ``start``.

    ``obs`` must be linearised near the solution: the problem is taken as linear around it.
    """
    names = [*start.sigma, *start.scale]
    free = np.array([name in start.free for name in names])
    if not free.any():
        return start
    given = np.array([*start.sigma.values(), *start.scale.values()])
    theta = 2.0 * np.log(given)
    smallest = {**dict.fromkeys(start.sigma, _SMALLEST), **dict.fromkeys(start.scale, _SMALLEST_SCALE)}
    smallest |= {**_FLOOR, **start.least}
    floor = np.log([smallest[name] ** 2 for name in names])
    ceiling = np.log([start.most.get(name, np.inf) ** 2 for name in names])
    found = start
    for _ in range(iterations):
        score, metric = _score(obs, prior, at, found)
        active = free & ~((theta <= floor + 1e-9) & (score < 0.0))
        active &= ~((theta >= ceiling - 1e-9) & (score > 0.0))
        if not active.any():
            break
        block = metric[np.ix_(active, active)]
        ridge = 1e-6 * np.eye(len(block)) * (1e-3 + np.trace(block))
        step = np.zeros(len(names))
        step[active] = np.clip(np.linalg.solve(block + ridge, score[active]), -_LONGEST, _LONGEST)
        theta = np.clip(theta + step, floor, ceiling)
        values = np.where(free, np.exp(0.5 * theta), given)
        found = replace(
            start,
            sigma=dict(zip(start.sigma, map(float, values), strict=False)),
            scale=dict(zip(start.scale, map(float, values[len(start.sigma) :]), strict=True)),
        )
        if abs(float(step @ score)) < _SETTLED:
            break
    return found


def with_mean_scales(obs: Observations, prior: Prior, at: Array, found: Components) -> Components:
    """``found`` with the free scales at the root of the mean of their squares: those found are the most
    likely ones, and a scale that few numbers tell may be larger by more than it may be smaller.

    The logarithm of a squared scale is taken as normal, with the curvature of its likelihood.
    """
    if not found.free & set(found.scale):
        return found
    _, metric = _score(obs, prior, at, found)
    variance = 1.0 / np.diag(metric)[len(found.sigma) :]
    mean = {
        name: scale * float(np.exp(0.25 * v)) if name in found.free else scale
        for (name, scale), v in zip(found.scale.items(), variance, strict=True)
    }
    return replace(found, scale=mean)


def evidence(obs: Observations, prior: Prior, at: Array, now: Components) -> float:
    """Logarithm of the restricted likelihood of ``now``, up to a constant of the observations alone; every
    prior enters with its size, so sets of unknowns can be compared by it.
    """
    eq = now.equations(obs, prior, at)
    x, _ = eq.step()
    of_noise = 0.0
    for rows in row_blocks(obs.n):
        r = eq.left(obs, rows, eq.follows(obs, rows), x)
        of_noise += float(np.einsum("ni,nij,nj->", r, eq.weight[rows], r, optimize=True))
    precision = prior.scaled(dict(now.scale)).precision
    stated = precision > 0.0
    sizes: float = (
        float(np.sum(np.linalg.slogdet(eq.weight)[1]) + np.sum(np.linalg.slogdet(eq.inverse)[1]))
        - eq.log_determinant
        - obs.dof * float(np.log(now.variance_of_sums))
        + float(np.sum(np.log(precision[stated])))
    )
    squares: float = (
        of_noise
        + obs.squares(x) / now.variance_of_sums
        + float(precision @ (at + x - prior.mean) ** 2)
        + sum(float(np.log(s) / np.log(SCALE_FACTOR)) ** 2 for s in now.scale.values())
    )
    return 0.5 * (sizes - squares)


def _score(obs: Observations, prior: Prior, at: Array, now: Components) -> tuple[Array, Array]:
    """Derivative of the restricted log-likelihood by the logarithms of the variances, and its metric.

    The metric leaves out what couples different observations: it steers the steps, the zero of the score is
    exact.
    """
    eq = now.equations(obs, prior, at)
    cov = np.where(np.isfinite(eq.covariance), eq.covariance, 0.0)
    x, _ = eq.step()
    square = np.array([s**2 for s in now.sigma.values()])
    k, every = len(square), len(square) + len(now.scale)
    score, metric = np.zeros(every), np.zeros((every, every))
    for rows in row_blocks(obs.n):
        follows, L, P = eq.follows(obs, rows), obs.of_local[rows], eq.weight[rows]
        Pr = P @ eq.left(obs, rows, follows, x)[..., None]
        carried = (follows.reshape(-1, len(cov)) @ cov).reshape(follows.shape)
        fitted = carried @ np.swapaxes(follows, 1, 2)
        fitted += L @ eq.inverse[obs.group[rows]] @ np.swapaxes(L, 1, 2)
        V = obs.parts[:, rows] * square[:, None, None, None]
        of_score, of_metric = scores_of_noise(V, P - P @ fitted @ P, Pr)
        score[:k] += of_score
        metric[:k, :k] += of_metric
    if now.of_sums in now.sigma:
        i = list(now.sigma).index(now.of_sums)
        left = obs.squares(x) / now.variance_of_sums
        dof = obs.dof - float(np.sum(obs.info * cov)) / now.variance_of_sums
        score[i] += 0.5 * (left - dof)
        metric[i, i] += 0.5 * max(dof, 1.0)
    precision = prior.scaled(dict(now.scale)).precision
    away = at + x - prior.mean
    for j, (name, scale) in enumerate(now.scale.items()):
        part = prior.blocks[name]
        root = np.sqrt(precision[part])
        told = np.eye(len(root)) - root[:, None] * cov[part, part] * root  # what the data decide of the block
        of_scale = np.log(scale**2) / (2.0 * np.log(SCALE_FACTOR)) ** 2
        score[k + j] = 0.5 * float(np.sum(precision[part] * away[part] ** 2) - np.trace(told)) - of_scale
        metric[k + j, k + j] = 0.5 * float(np.sum(told**2)) + (2.0 * np.log(SCALE_FACTOR)) ** -2.0
    return score, metric
