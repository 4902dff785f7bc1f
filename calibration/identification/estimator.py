"""Weighted maximum likelihood with the registration projected out (Golub and Pereyra 1973).

For given parameters the registration has a closed form; a Gauss-Newton step takes the derivatives of the
parameters and of the registration together (Kaufman 1975), so it converges as the full problem would. What
the data cannot determine is held by the prior, and damping comes in only when a step does not improve.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.identification.model import REGISTRATION, Model, Targets
from calibration.identification.registration import Registration, register
from cell.poses import Array

_ENOUGH = 1e-7  # of the cost: what a further step would gain
_NEAR = 0.1  # of the cost: what is left after a step that gains so little is of second order in a few sigma
_MOST_DAMPING = 1e12
Rows = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Problem:
    """n readings: joints ``Q`` (n, j), ``p`` (3, n) in the tracker frame (m), and their targets (n,)."""

    model: Model
    Q: Array
    p: Array
    target: Targets

    @property
    def n(self) -> int:
        return len(self.Q)

    @property
    def range_m(self) -> Array:
        """(n,): distance of the reflector from the tracker."""
        return np.asarray(np.sqrt(np.sum(self.p**2, axis=0)))

    @cached_property
    def scratch(self) -> Array:
        """(p + 6, 3, n) to write in: fresh memory costs as much as the sums made in it."""
        return np.empty((self.model.size + REGISTRATION, 3, self.n))

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> "Problem":
        return Problem(self.model, self.Q[rows], np.ascontiguousarray(self.p[:, rows]), self.target[rows])


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters ``x`` (p,), points ``f`` and residuals ``e`` (3, n) in the base, and the derivatives.

    ``J`` (p + 6, 3, n) belongs to ``x``, or to a place within a few standard deviations of it; ``H``
    (p + 6, p + 6) is the normal matrix with ``weight`` (n,) and the prior. ``cost`` is what is minimised:
    weighted squares, and squared distances from the prior.
    """

    x: Array
    f: Array
    J: Array
    registration: Registration
    e: Array
    weight: Array
    H: Array
    cost: float

    def covariance(self, model: Model, excess: float = 1.0) -> Array:
        """(p + 6, p + 6) of parameters and registration, for readings whose variance is ``excess`` times
        what their weights say; the prior stays as it is."""
        H = self.H
        if excess != 1.0:
            p = np.arange(model.size)
            H = H / excess
            H[p, p] += (1.0 - 1.0 / excess) * model.sd**-2.0
        D = 1.0 / np.sqrt(np.diag(H))
        C: Array = np.linalg.inv(H * np.outer(D, D)) * np.outer(D, D)
        return 0.5 * (C + C.T)


def fit(
    problem: Problem, start: Array | Fit, weight: Array, *, iterations: int = 12, free: Rows | None = None
) -> Fit:
    """The parameters that explain the readings best, from ``start`` (p,) or from an earlier fit.

    ``weight`` (n,) is one over the variance of a reading (1/m^2), zero for one left out. ``free`` (k,) names
    the parameters to adjust; all unless given.
    """
    model, damping = problem.model, 0.0
    if isinstance(start, Fit):
        best = start if np.array_equal(weight, start.weight) else _weighed(problem, start, weight)
    else:
        best = state_at(problem, np.array(start, dtype=float), weight)
    for _ in range(iterations):
        step, gain = _step(best, model, damping, free)
        if gain <= _ENOUGH * best.cost:
            break
        if gain <= _NEAR * best.cost and damping == 0.0:
            last = _moved(problem, best, step)
            return last if last.cost < best.cost else best
        now = state_at(problem, best.x + step, weight)
        if now.cost <= best.cost * (1.0 + 1e-12):
            best, damping = now, 0.0 if damping < 1e-6 else 0.1 * damping
        else:
            damping = max(10.0 * damping, 1e-6)
            if damping > _MOST_DAMPING:
                break
    return best


def state_at(problem: Problem, x: Array, weight: Array) -> Fit:
    """The arm as ``x`` (p,), unadjusted, with the registration that suits it best."""
    f, J = problem.model.linearised(x, problem.Q, problem.target)
    H = normal_matrix(J, weight, problem.scratch)
    p = problem.model.size
    H[np.arange(p), np.arange(p)] += problem.model.sd**-2.0
    return _fit(problem, x, f, J, weight, H)


def _weighed(problem: Problem, now: Fit, weight: Array) -> Fit:
    """The same arm under other weights."""
    H = normal_matrix(now.J, weight, problem.scratch)
    p = problem.model.size
    H[np.arange(p), np.arange(p)] += problem.model.sd**-2.0
    return _fit(problem, now.x, now.f, now.J, weight, H)


def _moved(problem: Problem, now: Fit, step: Array) -> Fit:
    """The arm after so small a step that the derivatives stay as they are."""
    x = now.x + step
    f = problem.model.points(x, problem.Q, problem.target)
    return _fit(problem, x, f, now.J, now.weight, now.H)


def _fit(problem: Problem, x: Array, f: Array, J: Array, weight: Array, H: Array) -> Fit:
    registration = register(problem.p, f, weight)
    e = registration.to_base(problem.p) - f
    away = (x - problem.model.nominal) / problem.model.sd
    return Fit(x, f, J, registration, e, weight, H, float(np.sum(weight * e**2) + away @ away))


def normal_matrix(J: Array, weight: Array, scratch: Array | None = None) -> Array:
    """(k, k): sum over readings of weighted products of derivatives ``J`` (k, 3, n)."""
    rows = np.multiply(J, np.sqrt(weight), out=scratch).reshape(len(J), -1)
    H: Array = rows @ rows.T
    return H


def _step(now: Fit, model: Model, damping: float, free: Rows | None) -> tuple[Array, float]:
    """(p,) step of the parameters, and how much the cost falls by it if the problem is linear."""
    g = now.J.reshape(len(now.J), -1) @ (now.weight * now.e).ravel()
    g[: model.size] += (model.nominal - now.x) / model.sd**2
    rows = np.arange(len(g))
    if free is not None:
        rows = np.concatenate([free, np.arange(model.size, model.size + REGISTRATION)])
    H = now.H if free is None else now.H[np.ix_(rows, rows)]
    D = 1.0 / np.sqrt(np.diag(H))
    A = H * np.outer(D, D)
    A[np.arange(len(A)), np.arange(len(A))] += damping
    u = D * np.linalg.solve(A, D * g[rows])
    out = np.zeros(len(g))
    out[rows] = u
    return out[: model.size], float(u @ g[rows])
