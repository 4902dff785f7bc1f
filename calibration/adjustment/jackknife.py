"""A second opinion on a covariance: what leaving out one observation after the other does to the answer.

The stated covariance rests on noise levels that hold for all observations alike. Where a few of them are far
worse than the others, or errors follow something that is no unknown, the answer moves more than stated when
one of them is left out; then the covariance is enlarged to what leaving out shows, in the directions where
it does. Source: Efron and Stein, The Jackknife Estimate of Variance, Ann. Stat. 9 (1981).
"""

from dataclasses import dataclass

import numpy as np

from calibration.adjustment.components import Components
from calibration.adjustment.equations import Equations, Observations
from calibration.hand_eye.normal import row_blocks
from cell.poses import Array

_CHANCE = 1e-3  # of enlarging where noise is as its levels have it
_TRACY_WIDOM = 3.2724  # that quantile of the law for real matrices
_DRAWS = 4000
_AT_ONCE = 400_000  # numbers that are drawn together
_LEVERAGE = 0.99  # of an observation that alone decides a direction: nothing is left to judge it by


@dataclass(frozen=True)
class Checked:
    """``cov`` (6, 6) as stated plus ``added`` (6, 6); the ``largest`` standard deviation by leaving out over
    the stated one, in any direction, and the ``limit`` that chance explains."""

    cov: Array
    added: Array
    largest: float
    limit: float


@dataclass(frozen=True)
class Jackknife:
    """``cov`` (k, k) by leaving out observations, and what each of them is ``expected`` (n, k, k) to add
    where noise is as its levels have it."""

    cov: Array
    expected: Array


def checked(cov: Array, by_leaving_out: Jackknife, excess: float = 1.0) -> Checked:
    """``excess`` times the covariance ``cov`` (6, 6) against that by leaving out observations.

    One that leaves a direction open stays as it is.
    """
    cov = excess * cov
    if not np.all(np.isfinite(cov)) or np.linalg.eigvalsh(cov)[0] <= 0.0:
        return Checked(cov, np.zeros_like(cov), 0.0, 1.0)
    root = np.linalg.cholesky(cov)
    white = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(white @ by_leaving_out.cov @ white.T)
    limit = at_least(len(by_leaving_out.expected), len(cov))
    if values[-1] > limit:
        limit = max(limit, by_chance(excess * white @ by_leaving_out.expected @ white.T))
    more = root @ vectors @ np.diag(np.where(values > limit, values - 1.0, 0.0)) @ vectors.T @ root.T
    return Checked(cov + more, more, float(np.sqrt(max(values[-1], 0.0))), float(np.sqrt(limit)))


def at_least(n: int, k: int) -> float:
    """The largest variance by leaving out of n observations that chance explains in any of k directions,
    where each of them matters alike.

    It is less than where some matter more. Source: Johnstone, On the distribution of the largest eigenvalue
    in principal components analysis, Ann. Stat. 29 (2001).
    """
    a, b = np.sqrt(max(n - 1.0, 1.0)), np.sqrt(k)
    return float((a + b) ** 2 + _TRACY_WIDOM * (a + b) * (1.0 / a + 1.0 / b) ** (1.0 / 3.0)) / n


def by_chance(expected: Array) -> float:
    """The largest variance in any direction that chance explains where observation i adds the square of a
    random vector with covariance ``expected[i]``, (n, k, k): drawn so, always with the same numbers."""
    n, k, _ = expected.shape
    root = np.linalg.cholesky(expected + 1e-9 * np.trace(expected.sum(axis=0)) / n * np.eye(k))
    rng = np.random.default_rng(0)
    largest: list[float] = []
    while len(largest) < _DRAWS:
        x = (root @ rng.normal(size=(max(_AT_ONCE // (n * k), 1), n, k, 1)))[..., 0]
        largest += np.linalg.eigvalsh(np.swapaxes(x, 1, 2) @ x)[:, -1].tolist()
    return float(np.quantile(largest, 1.0 - _CHANCE))


def jackknife(obs: Observations, components: Components, eq: Equations, count: int) -> Jackknife:
    """Covariance of the first ``count`` global unknowns, at the solution of ``eq``.

    Noise levels, scales of priors and what images say of lens and target stay as they are.
    """
    cov = np.where(np.isfinite(eq.covariance), eq.covariance, 0.0)
    fitted, told = np.empty_like(eq.weight), np.empty((obs.n, count, eq.weight.shape[1]))
    for rows in row_blocks(obs.n):
        follows = eq.follows(obs, rows)
        fitted[rows] = follows @ cov @ np.swapaxes(follows, 1, 2)
        told[rows] = cov[:count] @ np.swapaxes(follows, 1, 2)
    fitted += obs.of_local @ eq.inverse[obs.group] @ np.swapaxes(obs.of_local, 1, 2)
    root = np.linalg.cholesky(components.variances(obs.parts))
    white = np.linalg.inv(root)
    hat = white @ fitted @ np.swapaxes(white, 1, 2)
    values, vectors = np.linalg.eigh(0.5 * (hat + np.swapaxes(hat, 1, 2)))
    left = 1.0 / (1.0 - np.minimum(values, _LEVERAGE))
    e = (np.swapaxes(vectors, 1, 2) @ (white @ obs.r[..., None]))[..., 0] * left
    pulled = (vectors @ e[..., None])[..., 0]
    share = (obs.n - 1.0) / obs.n
    answer = told @ np.swapaxes(white, 1, 2)
    change = (answer @ pulled[..., None])[..., 0]
    change -= change.mean(axis=0)
    across = answer @ vectors
    return Jackknife(share * change.T @ change, share * (across * left[:, None]) @ np.swapaxes(across, 1, 2))
