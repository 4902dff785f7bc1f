"""The lengths that normal errors in several directions stay below."""

from functools import cache

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc, fdtri

from cell.poses import Array

_BEYOND95 = 0.05
_STEPS, _STEP = 4, 1e-3  # of Newton's method: how many, and of the length, for the slope
_NODES = 8  # of each angle: the length is right to 1e-4 of itself


def length95(cov: Array) -> float:
    """The length that 95 % of normal vectors with covariance ``cov`` (k, k) stay below."""
    return length_beyond(cov, _BEYOND95)


def length_beyond(cov: Array, probability: float) -> float:
    """The length that normal vectors with covariance ``cov`` (k, k) are beyond with ``probability``."""
    return float(lengths_beyond(np.asarray(cov)[None], probability)[0])


def lengths95(cov: Array, freedom: float = np.inf) -> Array:
    """(n,): the length of each of ``cov`` (n, k, k); ``freedom`` as in :func:`lengths_beyond`."""
    return lengths_beyond(cov, _BEYOND95, freedom)


def lengths_beyond(cov: Array, probability: float, freedom: float = np.inf) -> Array:
    """(n,): the lengths that normal vectors of k = 2 or 3 numbers are beyond with ``probability``, for each
    covariance of ``cov`` (n, k, k); 0 where it is zero, NaN where it is none.

    ``freedom`` degrees of freedom were left to estimate the size of ``cov`` with: few make it unsure itself,
    and the lengths larger (Hotelling 1931).

    A vector of unit normal numbers has a length and a direction that are independent, so the chance to be
    beyond is the mean over all directions of the chance that its length there is beyond. Newton's method
    begins at the chi-square with the mean and variance of the squared length (Satterthwaite 1946), which by
    itself is up to 4 % short where 1 of 300 may be beyond.
    """
    cov = np.asarray(cov, dtype=float)
    variances = np.full(cov.shape[:2], np.nan)
    finite = np.isfinite(cov).all(axis=(1, 2))
    variances[finite] = np.linalg.eigvalsh(cov[finite])
    out = np.where(np.all(variances == 0.0, axis=1), 0.0, np.nan)
    spread = variances[:, -1] > 0.0
    if spread.any():
        out[spread] = _lengths(variances[spread], probability, freedom)
    return out


def _lengths(variances: Array, probability: float, freedom: float) -> Array:
    """Of ``variances`` (n, k) along the axes, the largest last and above zero."""
    largest, k = np.sqrt(variances[:, -1]), variances.shape[1]
    share = np.clip(variances / variances[:, -1:], 0.0, 1.0)
    directions, weights = _directions(k)
    stretch = np.sqrt(share @ directions.T**2)  # (n, m) of a vector of unit length
    axes = share.sum(axis=1) ** 2 / np.sum(share**2, axis=1)
    if np.isinf(freedom):
        quantile = chdtri(axes, probability)
    else:
        quantile = axes * fdtri(axes, freedom, 1.0 - probability)
    length = np.sqrt(np.sum(share**2, axis=1) / share.sum(axis=1) * quantile)

    def log_beyond(length: Array) -> Array:
        squares = (length[:, None] / stretch) ** 2
        chance = chdtrc(k, squares) if np.isinf(freedom) else fdtrc(k, freedom, squares / k)
        return np.asarray(np.log(chance @ weights))

    for _ in range(_STEPS):
        here = log_beyond(length)
        slope = (log_beyond((1.0 + _STEP) * length) - here) / _STEP
        length = length * (1.0 + (np.log(probability) - here) / slope)
    return np.asarray(largest * length)


@cache
def _directions(k: int) -> tuple[Array, Array]:
    """Unit vectors (m, k) of the part of the circle or sphere in which all numbers are positive, and their
    weights (m,), by Gauss and Legendre in the angle and in the height."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    nodes, weights = 0.5 * (1.0 + nodes), 0.5 * weights
    across = np.stack([np.cos(0.5 * np.pi * nodes), np.sin(0.5 * np.pi * nodes)], axis=1)
    if k == 2:
        return across, weights
    up = np.repeat(nodes, _NODES)
    flat = np.sqrt(1.0 - up**2)[:, None] * np.tile(across, (_NODES, 1))
    return np.column_stack([flat, up]), np.outer(weights, weights).ravel()
