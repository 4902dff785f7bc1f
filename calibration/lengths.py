"""The lengths that normal errors in several directions stay below."""

import numpy as np
from scipy.special import chdtrc, chdtri, fdtri

from cell.poses import Array

_BEYOND95 = 0.05
_STEPS, _STEP = 4, 1e-3  # of Newton's method: how many, and of the length, for the slope
_ROUNDING = 1e-9  # of the largest variance, by which a smaller one may come out below zero
_NODES = 8  # of each angle: the length is right to 1e-4 of itself


def length95(cov: Array) -> float:
    """The length that 95 % of normal vectors with covariance ``cov`` (k, k) stay below, as in
    :func:`lengths95`."""
    return float(lengths95(np.asarray(cov)[None])[0])


def lengths95(cov: Array, freedom: float = np.inf) -> Array:
    """(n,): the length that 95 % of normal vectors with each covariance of ``cov`` (n, k, k) stay below; 0
    where it is zero, NaN where it is none. To half a percent, and to one with few degrees of freedom, by the
    chi-square with the mean and variance of the squared length (Satterthwaite 1946, Box 1954).

    ``freedom`` degrees of freedom were left to estimate the size of ``cov`` with: few make it unsure itself,
    and the lengths larger (Hotelling 1931).
    """
    variances, out = _variances(cov)
    spread = variances[:, -1] > 0.0
    out[spread] = _matched(variances[spread], _BEYOND95, freedom)
    return out


def length_beyond(cov: Array, probability: float) -> float:
    """The length that normal vectors of k = 1, 2 or 3 numbers with covariance ``cov`` (k, k) are beyond with
    ``probability``; 0 and NaN as in :func:`lengths95`.

    Exact, as the matched chi-square is up to 4 % short where 1 of 300 may be beyond. A vector of unit normal
    numbers has a length and a direction that are independent, so the chance to be beyond is the mean over all
    directions of the chance that its length there is beyond.
    """
    variances, out = _variances(np.asarray(cov)[None])
    if not variances[0, -1] > 0.0:
        return float(out[0])
    share, k = variances[0] / variances[0, -1], variances.shape[1]
    directions, weights = _directions(k)
    stretch = directions**2 @ share  # (m,) of the square of a vector of unit length

    def log_beyond(length: float) -> float:
        return float(np.log(chdtrc(k, length**2 / stretch) @ weights))

    length = float(_matched(share[None], probability)[0])
    for _ in range(_STEPS):
        here = log_beyond(length)
        slope = (log_beyond((1.0 + _STEP) * length) - here) / _STEP
        length *= 1.0 + (np.log(probability) - here) / slope
    return float(np.sqrt(variances[0, -1]) * length)


def _variances(cov: Array) -> tuple[Array, Array]:
    """(n, k) along the axes of ``cov`` (n, k, k), the largest last; and (n,) 0 where all are, else NaN."""
    cov = np.asarray(cov, dtype=float)
    variances = np.full(cov.shape[:2], np.nan)
    finite = np.isfinite(cov).all(axis=(1, 2))
    variances[finite] = np.linalg.eigvalsh(cov[finite])
    variances[variances[:, 0] < -_ROUNDING * np.abs(variances[:, -1])] = np.nan
    variances = np.maximum(variances, 0.0)
    return variances, np.where(np.all(variances == 0.0, axis=1), 0.0, np.nan)


def _matched(variances: Array, probability: float, freedom: float = np.inf) -> Array:
    """(n,) lengths by the chi-square that has as many degrees of freedom as a round cloud would need for the
    mean and variance of the squared length; ``variances`` (n, k)."""
    mean, half = variances.sum(axis=1), np.sum(variances**2, axis=1)
    axes = mean**2 / half
    if np.isinf(freedom):
        quantile = chdtri(axes, probability)
    else:
        quantile = axes * fdtri(axes, freedom, 1.0 - probability)
    return np.asarray(np.sqrt(half / mean * quantile))


def _directions(k: int) -> tuple[Array, Array]:
    """Unit vectors (m, k) of the part of the line, circle or sphere in which all numbers are positive, and
    their weights (m,), by Gauss and Legendre in the angle and in the height."""
    if k == 1:
        return np.ones((1, 1)), np.ones(1)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    nodes, weights = 0.5 * (1.0 + nodes), 0.5 * weights
    across = np.stack([np.cos(0.5 * np.pi * nodes), np.sin(0.5 * np.pi * nodes)], axis=1)
    if k == 2:
        return across, weights
    up = np.repeat(nodes, _NODES)
    flat = np.sqrt(1.0 - up**2)[:, None] * np.tile(across, (_NODES, 1))
    return np.column_stack([flat, up]), np.outer(weights, weights).ravel()
