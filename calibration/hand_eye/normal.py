"""Normal equations of the weighted problem, and its maximum-likelihood solution.

The sum over observations of ``r^T V^-1 r`` is minimised over X and one W per group by Gauss-Newton. An
observation touches X and its own W only, so every W is eliminated on its own (Schur complement): all costs
grow with n, none with n times groups, and no matrix is larger than 12 x 12.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye.problem import Estimate, Groups, Problem, jacobians, residuals
from cell.poses import Array

_CONVERGED = 1e-12  # gain of a step over the cost


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


@dataclass(frozen=True)
class Covariance:
    """``X`` (6, 6), and ``own`` (g, 12, 12) over X and one W. Unobservable directions have zero variance."""

    X: Array
    own: Array


@dataclass(frozen=True)
class Normal:
    """Normal matrices ``own`` (g, 12, 12) and gradients ``g`` (g, 12) over X and one W, one per group."""

    own: Array
    g: Array

    def __sub__(self, other: "Normal") -> "Normal":
        return Normal(self.own - other.own, self.g - other.g)

    def _eliminated(self) -> tuple[Array, Array, Array, Array]:
        """Schur complement (6, 6) and its gradient (6,), ``WW^-1`` (g, 6, 6) and ``WW^-1 WX`` (g, 6, 6)."""
        inverse = pseudo_inverse(self.own[:, 6:, 6:])
        carry = inverse @ self.own[:, 6:, :6]
        schur = self.own[:, :6, :6].sum(axis=0) - (self.own[:, :6, 6:] @ carry).sum(axis=0)
        gradient = self.g[:, :6].sum(axis=0) - np.einsum("gji,gj->i", carry, self.g[:, 6:])
        return schur, gradient, inverse, carry

    def solve(self) -> Array:
        """N^-1 g as (1 + g, 6): X first, then each W."""
        schur, gradient, inverse, carry = self._eliminated()
        x = pseudo_inverse(schur[None])[0] @ gradient
        w = (inverse @ self.g[:, 6:, None])[..., 0] - carry @ x
        return np.concatenate([x[None], w])

    def covariance(self) -> Covariance:
        """N^-1, as far as one observation can see it."""
        schur, _, inverse, carry = self._eliminated()
        X = pseudo_inverse(schur[None])[0]
        own = np.empty_like(self.own)
        own[:, :6, :6] = X
        own[:, 6:, :6] = -carry @ X
        own[:, :6, 6:] = np.swapaxes(own[:, 6:, :6], 1, 2)
        own[:, 6:, 6:] = inverse - own[:, 6:, :6] @ np.swapaxes(carry, 1, 2)
        return Covariance(X, own)

    def scalar(self, step: Array) -> float:
        """g^T step."""
        return float(np.sum(self.g[:, :6] @ step[0]) + np.sum(self.g[:, 6:] * step[1:]))


def pseudo_inverse(N: Array) -> Array:
    """Inverses of symmetric (k, 6, 6) that mix metres and radians; directions without information give 0."""
    s = 1.0 / np.sqrt(np.maximum(np.einsum("kii->ki", N), 1e-300))
    scale = s[:, :, None] * s[:, None, :]
    return np.asarray(np.linalg.pinv(N * scale, rcond=1e-13, hermitian=True) * scale)


def normal(lin: Linearised, weight: Array) -> Normal:
    """Normal equations ``J^T V^-1 J`` and ``J^T V^-1 r`` for weights V^-1 (n, 6, 6)."""
    own, g = own_normal(lin, weight)
    return gathered(own, g, lin.problem.group, lin.problem.groups)


def own_normal(lin: Linearised, weight: Array) -> tuple[Array, Array]:
    """Contributions (n, 12, 12) and (n, 12) of the observations."""
    JtP = np.swapaxes(lin.J, 1, 2) @ weight
    return JtP @ lin.J, (JtP @ lin.r[..., None])[..., 0]


def gathered(own: Array, g: Array, group: Groups, groups: int) -> Normal:
    """Contributions of observations added up by group."""
    member = (group == np.arange(groups)[:, None]).astype(float)
    return Normal((member @ own.reshape(len(own), 144)).reshape(groups, 12, 12), member @ g)


def gauss_newton(problem: Problem, start: Estimate, weight: Array, iterations: int = 20) -> Linearised:
    """Minimise ``sum r^T V^-1 r`` from ``start``; ``weight`` (n, 6, 6) stays fixed."""
    return minimise(linearise(problem, start), weight, iterations)


def minimise(lin: Linearised, weight: Array, iterations: int = 20) -> Linearised:
    """As :func:`gauss_newton` from a linearised problem. A step that does not lower the cost is halved."""
    cost = _cost(lin.r, weight)
    for _ in range(iterations):
        equations = normal(lin, weight)
        step = -equations.solve()
        if -equations.scalar(step) < _CONVERGED * cost + 1e-24:
            break
        for _ in range(6):
            trial = linearise(lin.problem, lin.at.moved(step))
            trial_cost = _cost(trial.r, weight)
            if trial_cost <= cost * (1.0 + 1e-12):
                break
            step = 0.5 * step
        else:
            return lin
        lin, cost = trial, trial_cost
    return lin


def squared_distances(r: Array, weight: Array) -> NDArray[np.float64]:
    """``r^T V^-1 r`` (n,)."""
    return np.asarray(np.einsum("ni,nij,nj->n", r, weight, r, optimize=True))


def _cost(r: Array, weight: Array) -> float:
    return float(squared_distances(r, weight).sum())
