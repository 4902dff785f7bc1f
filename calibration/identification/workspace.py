"""How far the calibrated arm will be off, at places that were not measured."""

from dataclasses import dataclass

import numpy as np

from calibration.identification.model import Model
from calibration.identification.solution import Solution, base_covariance
from calibration.lengths import lengths95
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
        errors.append(lengths95(base_covariance(cov, J), freedom))
    worst, rows = np.argmax(errors, axis=0), np.arange(len(Q))
    return WorkspaceErrors(Q, np.array(points)[worst, rows], np.array(errors)[worst, rows])


def places(Q: Array, count: int = _PLACES) -> Array:
    """Joints (count, j) spread evenly over the ranges of ``Q`` (n, j), the same ones every time."""
    rng = np.random.default_rng(0)
    low, high = Q.min(axis=0), Q.max(axis=0)
    strata = (np.argsort(rng.random((Q.shape[1], count)), axis=1).T + rng.random((count, Q.shape[1]))) / count
    out: Array = low + strata * (high - low)
    return out
