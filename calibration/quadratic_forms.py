"""How long vectors of many normal numbers are by chance.

The squared length is a sum of squares of independent normal numbers. How often that is beyond a limit
follows from its cumulants by the saddlepoint approximation (Lugannani and Rice 1980, in the form of
Barndorff-Nielsen 1986; Kuonen, "Saddlepoint approximations for distributions of quadratic forms in normal
variables", Biometrika 86, 1999): to a few percent of the probability however small that is, and to one of the
length where it is below a half.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import log_ndtr

from cell.poses import Array

_NEAR_MEAN = 1e-4  # standard deviations, within which the limit is taken of what is 0 over 0
_INSIDE = 1.0 - 1e-12  # of the interval that the saddlepoint is in


def size_beyond(variances: Array, probability: float, freedom: float = np.inf) -> float:
    """The length that a vector of independent normal numbers with ``variances`` (k,) is beyond with
    ``probability``; 0 where all are zero.

    ``freedom`` degrees of freedom were left to estimate the size of ``variances`` with, as in
    :func:`calibration.lengths.lengths95`.
    """
    largest = float(np.max(variances))
    if not largest > 0.0:
        return 0.0
    share = np.asarray(variances)[np.asarray(variances) > 0.0] / largest
    wanted = float(np.log(probability))

    def off(log_square: float) -> float:
        return _log_beyond(share, float(np.exp(log_square)), freedom) - wanted

    low = high = float(np.log(np.sum(share)))
    while off(low) < 0.0:
        low -= 1.0
    while off(high) > 0.0:
        high += 1.0
    return float(np.sqrt(largest * np.exp(brentq(off, low - 1e-6, high + 1e-6))))


def _log_beyond(share: Array, square: float, freedom: float) -> float:
    """The logarithm of the chance that the sum of squares is beyond ``square``.

    With an estimated size it is the chance that the sum less ``square`` times the size, which is distributed
    as chi-square over its degrees of freedom, is positive: another sum, with a negative share.
    """
    weight, times, limit = share, np.ones(len(share)), square
    lowest = -0.5 * len(share) / square
    if np.isfinite(freedom):
        weight, times = np.append(share, -square / freedom), np.append(times, freedom)
        limit, lowest = 0.0, -0.5 * freedom / square

    def beside(t: float) -> float:
        return float(times @ (weight / (1.0 - 2.0 * weight * t))) - limit

    t = float(brentq(beside, _INSIDE * lowest, 0.5 * _INSIDE / float(np.max(share))))
    left = 1.0 - 2.0 * weight * t
    curve = 2.0 * float(times @ (weight / left) ** 2)
    w = np.sign(t) * np.sqrt(max(2.0 * t * limit + float(times @ np.log(left)), 0.0))
    if abs(w) < _NEAR_MEAN:
        return float(log_ndtr(-w - 8.0 * float(times @ (weight / left) ** 3) / (6.0 * curve**1.5)))
    return float(log_ndtr(-w - np.log(t * np.sqrt(curve) / w) / w))
