"""Normal equations of the weighted problem, and its maximum-likelihood solution.

The sum over observations of ``r^T V^-1 r`` is minimised over X and one W per group by Gauss-Newton. Blocks
of one group are added up before they meet the others, so the cost grows with n and not with n times groups.
"""

from dataclasses import dataclass

import numpy as np

from calibration.hand_eye.problem import Estimate, Problem, jacobians, residuals
from cell.poses import Array


@dataclass(frozen=True)
class Linearised:
    """The problem at one estimate: ``r`` (n, 6), own Jacobian ``J`` (n, 6, 12) over X and the group's W."""

    problem: Problem
    at: Estimate
    r: Array
    predicted: Array
    J: Array


def linearise(problem: Problem, at: Estimate) -> Linearised:
    """Residuals and Jacobians of all observations at ``at``."""
    r, predicted = residuals(problem, at)
    return Linearised(problem, at, r, predicted, np.concatenate(jacobians(r, predicted), axis=2))


def assemble(problem: Problem, own: Array) -> Array:
    """Sum (p, p) over observations of blocks ``own`` (n, 12, 12) over X and the group's W; p = 6 + 6 g."""
    g = problem.groups
    per_group = np.zeros((g, 12, 12))
    np.add.at(per_group, problem.group, own)
    N = np.zeros((g + 1, 6, g + 1, 6))
    N[0, :, 0] = per_group[:, :6, :6].sum(axis=0)
    for k in range(g):
        N[0, :, k + 1], N[k + 1, :, 0] = per_group[k, :6, 6:], per_group[k, 6:, :6]
        N[k + 1, :, k + 1] = per_group[k, 6:, 6:]
    return N.reshape(6 * (g + 1), 6 * (g + 1))


def assemble_vector(problem: Problem, own: Array) -> Array:
    """Sum (p,) over observations of ``own`` (n, 12)."""
    out = np.zeros((problem.groups + 1, 6))
    out[0] = own[:, :6].sum(axis=0)
    np.add.at(out[1:], problem.group, own[:, 6:])
    return out.ravel()


def information(lin: Linearised, weight: Array) -> tuple[Array, Array]:
    """Normal matrix (p, p) and gradient (p,) ``J^T V^-1 r`` for weights V^-1 (n, 6, 6)."""
    JtP = np.swapaxes(lin.J, 1, 2) @ weight
    own = JtP @ lin.J
    return assemble(lin.problem, own), assemble_vector(lin.problem, (JtP @ lin.r[..., None])[..., 0])


def solve_normal(N: Array, g: Array) -> Array:
    """N^-1 g with the scale of metres and radians taken out first."""
    s = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
    scaled = N * s[:, None] * s
    return np.asarray(s * np.linalg.lstsq(scaled, s * g, rcond=1e-14)[0])


def covariance(N: Array) -> Array:
    """N^-1 (p, p), scaled like :func:`solve_normal`."""
    s = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
    return np.asarray(np.linalg.pinv(N * s[:, None] * s, rcond=1e-14, hermitian=True) * s[:, None] * s)


def gauss_newton(problem: Problem, start: Estimate, weight: Array, iterations: int = 20) -> Linearised:
    """Minimise ``sum r^T V^-1 r`` from ``start``; ``weight`` (n, 6, 6) stays fixed.

    Ends when a step gains less than 1e-10 of the cost. A step that does not lower the cost is halved.
    """
    lin = linearise(problem, start)
    cost = _cost(lin.r, weight)
    for _ in range(iterations):
        N, g = information(lin, weight)
        step = -solve_normal(N, g)
        gain = float(-step @ g)
        for _ in range(6):
            trial = linearise(problem, lin.at.moved(step))
            trial_cost = _cost(trial.r, weight)
            if trial_cost <= cost * (1.0 + 1e-12):
                break
            step = 0.5 * step
        else:
            return lin
        lin, cost = trial, trial_cost
        if gain < 1e-10 * cost + 1e-24:
            break
    return lin


def _cost(r: Array, weight: Array) -> float:
    return float(np.sum(r * (weight @ r[..., None])[..., 0]))
