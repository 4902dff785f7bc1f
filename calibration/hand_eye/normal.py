"""Normal equations of the weighted problem, and its maximum-likelihood solution.

The sum over observations of ``r^T V^-1 r`` is minimised over X and one W per group by Gauss-Newton. An
observation touches X and its own W only, so every W is eliminated on its own (Schur complement): all costs
grow with n, none with n times groups, and no matrix is larger than 12 x 12.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye.problem import Estimate, Groups, Problem, jacobians, residuals
from cell.poses import Array

_CONVERGED = 1e-12  # gain of a step over the cost
_NOTHING = 1e-100  # information below this would overflow when it is scaled to one
_BLOCK, _MANY = 250, 1000  # observations
_SOUND = 1e-10  # determinant of a matrix of unit diagonal that is inverted without its eigenvalues


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
    J = np.empty((problem.n, 6, 12))
    for rows in row_blocks(problem.n, _MANY):
        J[rows, :, :6], J[rows, :, 6:] = jacobians(r[rows], predicted[rows])
    return Linearised(problem, at, r, predicted, J)


@dataclass(frozen=True)
class Covariance:
    """``X`` (6, 6), and ``own`` (g, 12, 12) over X and one W. Unobservable directions have zero variance."""

    X: Array
    own: Array


@dataclass(frozen=True)
class Eliminated:
    """What each group says of X when its W follows: ``schur`` (g, 6, 6) and ``gradient`` (g, 6) add up.

    ``inverse`` (g, 6, 6) is ``WW^-1`` and ``carry`` (g, 6, 6) ``WW^-1 WX``.
    """

    schur: Array
    gradient: Array
    inverse: Array
    carry: Array

    def covariances(self, X: Array) -> Array:
        """Of X and one W (g, 12, 12), with the covariance of X: (6, 6), or (g, 6, 6)."""
        own = np.empty((len(self.inverse), 12, 12))
        own[:, :6, :6] = X
        own[:, 6:, :6] = -self.carry @ X
        own[:, :6, 6:] = np.swapaxes(own[:, 6:, :6], 1, 2)
        own[:, 6:, 6:] = self.inverse - own[:, 6:, :6] @ np.swapaxes(self.carry, 1, 2)
        return own


@dataclass(frozen=True)
class Normal:
    """Normal matrices ``own`` (g, 12, 12) and gradients ``g`` (g, 12) over X and one W, one per group."""

    own: Array
    g: Array

    def __sub__(self, other: "Normal") -> "Normal":
        return Normal(self.own - other.own, self.g - other.g)

    @cached_property
    def eliminated(self) -> "Eliminated":
        """Each group with its own W taken out."""
        inverse = pseudo_inverse(self.own[:, 6:, 6:])
        carry = inverse @ self.own[:, 6:, :6]
        schur = self.own[:, :6, :6] - self.own[:, :6, 6:] @ carry
        gradient = self.g[:, :6] - np.einsum("gji,gj->gi", carry, self.g[:, 6:])
        return Eliminated(schur, gradient, inverse, carry)

    def solve(self) -> Array:
        """N^-1 g as (1 + g, 6): X first, then each W."""
        part = self.eliminated
        x = self._cov_X @ part.gradient.sum(axis=0)
        w = (part.inverse @ self.g[:, 6:, None])[..., 0] - part.carry @ x
        return np.concatenate([x[None], w])

    def covariance(self) -> Covariance:
        """N^-1, as far as one observation can see it."""
        return Covariance(self._cov_X, self.eliminated.covariances(self._cov_X))

    @cached_property
    def _cov_X(self) -> Array:
        """(6, 6)."""
        out: Array = pseudo_inverse(self.eliminated.schur.sum(axis=0)[None])[0]
        return out

    def each(self) -> Array:
        """N^-1 (g, 12, 12) of every group as if it were the only one."""
        part = self.eliminated
        return part.covariances(pseudo_inverse(part.schur))

    def scalar(self, step: Array) -> float:
        """g^T step."""
        return float(np.sum(self.g[:, :6] @ step[0]) + np.sum(self.g[:, 6:] * step[1:]))


def pseudo_inverse(N: Array) -> Array:
    """Inverses of symmetric (k, 6, 6) that mix metres and radians; directions without information give 0.

    What is left of a difference of equal matrices may be a little below zero on its diagonal: that is no
    information either.
    """
    diagonal = np.einsum("kii->ki", N)
    s = np.where(diagonal > _NOTHING, 1.0 / np.sqrt(np.maximum(diagonal, _NOTHING)), 0.0)
    scale = s[:, :, None] * s[:, None, :]
    scaled = N * scale
    sound = np.linalg.det(scaled) > _SOUND
    out = np.empty_like(N)
    out[sound] = np.linalg.inv(scaled[sound])
    if not sound.all():
        values, vectors = np.linalg.eigh(scaled[~sound])
        known = np.abs(values) > 1e-13 * np.abs(values).max(axis=1, keepdims=True)
        inverse = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
        out[~sound] = (vectors * inverse[:, None]) @ np.swapaxes(vectors, 1, 2)
    out *= scale
    return out


def row_blocks(n: int, most: int = _BLOCK) -> list[slice]:
    """Of n observations some hundred at a time, for what takes much memory of each: products over 100
    unknowns of so many take 5 MB."""
    return [slice(k, min(k + most, n)) for k in range(0, n, most)]


def normal(lin: Linearised, weight: Array) -> Normal:
    """Normal equations ``J^T V^-1 J`` and ``J^T V^-1 r`` for weights V^-1 (n, 6, 6)."""
    J, problem = lin.J, lin.problem
    weighted = np.empty((problem.n, 6, 13))
    np.matmul(weight, J, out=weighted[..., :12])
    np.matmul(weight, lin.r[..., None], out=weighted[..., 12:])
    sums = np.zeros((problem.groups, 12, 13))
    for one, own in each_group(problem.group):
        sums[one] = J[own].reshape(-1, 12).T @ weighted[own].reshape(-1, 13)
    return Normal(sums[..., :12], sums[..., 12])


def each_group(group: Groups) -> Iterator[tuple[int, slice | Groups]]:
    """Each group in ``group`` (k,) with its rows: a slice where they follow each other."""
    if len(group) and np.all(group[1:] >= group[:-1]):
        first = np.flatnonzero(np.diff(group, prepend=-1)).tolist()
        for start, end in zip(first, [*first[1:], len(group)], strict=True):
            yield int(group[start]), slice(start, end)
        return
    for one in np.unique(group).tolist():
        yield one, np.flatnonzero(group == one)


def own_normal(lin: Linearised, weight: Array, rows: Groups | None = None) -> tuple[Array, Array]:
    """Contributions (n, 12, 12) and (n, 12) of the observations, or of some ``rows`` of them."""
    take = slice(None) if rows is None else rows
    J = lin.J[take]
    JtP = np.swapaxes(J, 1, 2) @ weight[take]
    return JtP @ J, (JtP @ lin.r[take][..., None])[..., 0]


def gathered(own: Array, g: Array, group: Groups, groups: int) -> Normal:
    """Contributions of observations added up by group; a group without any gets zeros."""
    if np.any(group[1:] < group[:-1]):
        order = np.argsort(group, kind="stable")
        own, g, group = own[order], g[order], group[order]
    first = np.flatnonzero(np.diff(group, prepend=-1))
    sums = np.zeros((groups, 12, 12)), np.zeros((groups, 12))
    if len(group):
        sums[0][group[first]] = np.add.reduceat(own, first, axis=0)
        sums[1][group[first]] = np.add.reduceat(g, first, axis=0)
    return Normal(*sums)


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
    return np.asarray(np.sum((weight @ r[..., None])[..., 0] * r, axis=1))


def _cost(r: Array, weight: Array) -> float:
    return float(squared_distances(r, weight).sum())
