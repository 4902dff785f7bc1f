"""The classic method: registration by singular values in every iteration, then Levenberg-Marquardt.

Residual ``l = T p_tracker - f(q)``, T the registration that fits the present arm best; the step is
``+ (J^T J + mu I)^-1 J^T l`` with the derivatives of the parameters alone. mu falls tenfold after a better
step and rises tenfold after a worse one, which is not taken. Lengths are in millimetres, as the stop rules
are: the iteration limit, a change of the RMS of at most 0.001 mm, or a gradient of at most 0.001.
"""

from dataclasses import dataclass

import numpy as np

from calibration.identification.estimator import Problem
from calibration.identification.model import REGISTRATION
from calibration.identification.registration import Registration, register
from cell.poses import Array

ITERATIONS = 100
MU = 1e-3
_RMS_CHANGE_MM = 1e-3
_GRADIENT = 1e-3
_MM = 1e3
_MOST_MU = 1e15


@dataclass(frozen=True, eq=False)
class Classic:
    """Parameters ``x`` (p,) in SI units, the registration, residuals ``e`` (3, n) in the base in metres."""

    x: Array
    registration: Registration
    e: Array
    iterations: int
    stopped: str


def solve_classic(problem: Problem, start: Array | None = None) -> Classic:
    """All readings weigh the same, blunders too; ``start`` (p,) is the nominal arm unless given."""
    model = problem.model
    unit = np.array([_MM if kind == "length" else 1.0 for kind in model.kinds])
    even = np.ones(problem.n)
    x = np.array(model.nominal if start is None else start, dtype=float)
    mu, stopped, taken = MU, "iteration limit", 0
    place, e, J = _state(problem, x, even)
    for _ in range(ITERATIONS):
        A = (_MM * J / unit[:, None, None]).reshape(model.size, -1)
        gradient = A @ (_MM * e).ravel()
        if np.linalg.norm(gradient) <= _GRADIENT:
            stopped = "gradient"
            break
        step = _step(A @ A.T + mu * np.eye(model.size), gradient) / unit
        ahead = _state(problem, x + step, even)
        before, after = _rms_mm(e), _rms_mm(ahead[1])
        if after < before:
            x, (place, e, J) = x + step, ahead
            taken += 1
            mu /= 10.0
        else:
            mu *= 10.0
            if mu > _MOST_MU:
                stopped = "no better step"
                break
        if np.any(step) and abs(before - after) <= _RMS_CHANGE_MM:
            stopped = "change of RMS"
            break
    return Classic(x, place, e, taken, stopped)


def _state(problem: Problem, x: Array, even: Array) -> tuple[Registration, Array, Array]:
    f, J = problem.model.linearised(x, problem.Q, problem.target)
    place = register(problem.p, f, even)
    return place, place.to_base(problem.p) - f, J[:-REGISTRATION]


def _step(H: Array, gradient: Array) -> Array:
    """No step at all where mu has become too small for the open combinations: that is not better either."""
    try:
        step = np.asarray(np.linalg.solve(H, gradient), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.zeros_like(gradient)
    return step if np.all(np.isfinite(step)) else np.zeros_like(gradient)


def _rms_mm(e: Array) -> float:
    return _MM * float(np.sqrt(np.mean(np.sum(e**2, axis=0))))
