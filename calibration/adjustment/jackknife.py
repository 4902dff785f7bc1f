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
from cell.poses import Array

# Of variances in any direction: the ratio stayed below 1 + 120/n in 240 simulated captures without fault.
_CHANCE = 120.0
_LEVERAGE = 0.99  # of an observation that alone decides a direction: nothing is left to judge it by


@dataclass(frozen=True)
class Checked:
    """``cov`` (6, 6) as stated plus ``added`` (6, 6); the ``largest`` standard deviation by leaving out over
    the stated one, in any direction, and the ``limit`` that chance explains."""

    cov: Array
    added: Array
    largest: float
    limit: float


def checked(cov: Array, by_leaving_out: Array, n: int) -> Checked:
    """The covariance ``cov`` (6, 6) of n observations against that by leaving one out.

    One that leaves a direction open stays as it is.
    """
    limit = 1.0 + _CHANCE / n
    if not np.all(np.isfinite(cov)) or np.linalg.eigvalsh(cov)[0] <= 0.0:
        return Checked(cov, np.zeros_like(cov), 0.0, float(np.sqrt(limit)))
    root = np.linalg.cholesky(cov)
    white = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(white @ by_leaving_out @ white.T)
    more = root @ vectors @ np.diag(np.where(values > limit, values - 1.0, 0.0)) @ vectors.T @ root.T
    return Checked(cov + more, more, float(np.sqrt(max(values[-1], 0.0))), float(np.sqrt(limit)))


def jackknife(obs: Observations, components: Components, eq: Equations, count: int) -> Array:
    """(count, count) covariance of the first ``count`` global unknowns, at the solution of ``eq``.

    Noise levels, scales of priors and what images say of lens and target stay as they are.
    """
    cov = np.where(np.isfinite(eq.covariance), eq.covariance, 0.0)
    follows = obs.of_global - obs.of_local @ eq.carry[obs.group]
    fitted = follows @ cov @ np.swapaxes(follows, 1, 2)
    fitted += obs.of_local @ eq.inverse[obs.group] @ np.swapaxes(obs.of_local, 1, 2)
    root = np.linalg.cholesky(components.variances(obs.parts))
    white = np.linalg.inv(root)
    hat = white @ fitted @ np.swapaxes(white, 1, 2)
    values, vectors = np.linalg.eigh(0.5 * (hat + np.swapaxes(hat, 1, 2)))
    left = 1.0 / (1.0 - np.minimum(values, _LEVERAGE))
    e = (np.swapaxes(vectors, 1, 2) @ (white @ obs.r[..., None]))[..., 0] * left
    pulled = (vectors @ e[..., None])[..., 0]
    change = np.einsum(
        "mk,nik,nij,nj->nm", cov[:count], follows, np.swapaxes(white, 1, 2), pulled, optimize=True
    )
    change -= change.mean(axis=0)
    out: Array = (obs.n - 1.0) / obs.n * change.T @ change
    return out
