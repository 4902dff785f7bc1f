"""The lengths that normal errors in several directions stay below."""

import numpy as np
from scipy.special import chdtri, fdtri

from cell.poses import Array

_BEYOND = 0.05


def length95(cov: Array) -> float:
    """The length that 95 % of normal vectors with covariance ``cov`` (k, k) stay below."""
    return length_beyond(cov, _BEYOND)


def length_beyond(cov: Array, probability: float) -> float:
    """The length that normal vectors with covariance ``cov`` (k, k) are beyond with ``probability``."""
    return float(lengths_beyond(np.asarray(cov)[None], probability)[0])


def lengths95(cov: Array, freedom: float = np.inf) -> Array:
    """(n,): the length of each of ``cov`` (n, k, k); ``freedom`` as in :func:`lengths_beyond`."""
    return lengths_beyond(cov, _BEYOND, freedom)


def lengths_beyond(cov: Array, probability: float, freedom: float = np.inf) -> Array:
    """(n,): see :func:`length_beyond`, of each of ``cov`` (n, k, k).

    A scaled chi-square with the mean and variance of the squared length (Satterthwaite 1946, Box 1954): as
    many axes as a round cloud of that size would have, so that a cloud that is long in one direction is not
    taken for a round one. ``freedom`` degrees of freedom were left to estimate the size of ``cov`` with: few
    make it unsure itself, and the lengths larger (Hotelling 1931).
    """
    trace = np.trace(cov, axis1=1, axis2=2)
    square = np.sum(cov * cov, axis=(1, 2))
    some = square > 0.0
    scale = np.divide(square, trace, out=np.zeros_like(trace), where=some)
    axes = np.divide(trace, scale, out=np.ones_like(trace), where=some)
    if np.isinf(freedom):
        quantile = chdtri(axes, probability)
    else:
        quantile = axes * fdtri(axes, freedom, 1.0 - probability)
    return np.asarray(np.sqrt(scale * quantile))
