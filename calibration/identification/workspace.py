"""How far the calibrated arm will be off, at places that were not measured."""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtri

from calibration.identification.model import Model
from calibration.identification.solution import Solution, base_covariance
from cell.poses import Array

_PLACES = 200


@dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """Per place: joints ``q`` (n, j), the reflector in the base ``p`` (n, 3) m, and the distance ``error95``
    (n,) m that 95 % of prediction errors stay below."""

    q: Array
    p: Array
    error95: Array


def forecast(solution: Solution, Q: Array) -> WorkspaceErrors:
    """The error of predicted places in the tracker frame, from the covariance of the parameters alone; at all
    joints ``Q`` (n, j) that of the reflector whose place is known worst there."""
    if solution.cov is None:
        p, _ = solution.predict(Q)
        return WorkspaceErrors(Q, solution.registration.to_base(p.T).T, np.full(len(Q), np.nan))
    return worst_forecast(solution.model, solution.x, solution.cov, solution.freedom, Q)


def worst_forecast(model: Model, x: Array, cov: Array, freedom: float, Q: Array) -> WorkspaceErrors:
    """See :func:`forecast`: for parameters ``x`` (p,) with ``cov`` (p + 6, p + 6)."""
    points, errors = [], []
    for target in range(len(model.targets)):
        f, J = model.linearised(x, Q, np.full(len(Q), target, dtype=np.int64))
        points.append(f.T)
        errors.append(radius95(base_covariance(cov, J), freedom))
    worst, rows = np.argmax(errors, axis=0), np.arange(len(Q))
    return WorkspaceErrors(Q, np.array(points)[worst, rows], np.array(errors)[worst, rows])


def radius95(cov: Array, freedom: float = np.inf) -> Array:
    """(n,): lengths that 95 % of normal vectors with ``cov`` (n, 3, 3) stay below (Satterthwaite 1946).

    ``freedom`` degrees of freedom were left to estimate the size of ``cov`` with: few make it unsure itself,
    and the lengths larger (Hotelling 1931).
    """
    trace = np.trace(cov, axis1=1, axis2=2)
    square = np.maximum(np.sum(cov * cov, axis=(1, 2)), 1e-300)
    axes = trace**2 / square  # as many as a round cloud of this size would have
    quantile = chdtri(axes, 0.05) if np.isinf(freedom) else axes * fdtri(axes, freedom, 0.95)
    out: Array = np.sqrt(square / np.maximum(trace, 1e-300) * quantile)
    return out


def places(Q: Array, count: int = _PLACES) -> Array:
    """Joints (count, j) spread evenly over the ranges of ``Q`` (n, j), the same ones every time."""
    rng = np.random.default_rng(0)
    low, high = Q.min(axis=0), Q.max(axis=0)
    strata = (np.argsort(rng.random((Q.shape[1], count)), axis=1).T + rng.random((count, Q.shape[1]))) / count
    out: Array = low + strata * (high - low)
    return out
