"""Weighted least squares of the intervals' middles: what plain averaging makes of the same edges.

It is where the posterior starts, what finds blunders, and what the bench prints beside the answer.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from calibration.tool_frame.bounds import LateralModel, Rows
from cell.poses import Array

_TUKEY = 4.685
_ROUNDS = 6
_NONE = 1e-9  # of the largest singular value


@dataclass(frozen=True, eq=False)
class AveragingFit:
    """``psi`` (d,) and ``e`` (m,) with the covariance (d+m, d+m) of both, and the noise ``sigma`` (m) that
    the residuals show beyond what the intervals' widths explain. ``rest`` (n,) m are the residuals."""

    psi: Array
    e: Array
    cov: Array
    sigma: float
    rest: Array


def average(rows: Rows, model: LateralModel, weight: Array | None = None, sigma: float = 0.0) -> AveragingFit:
    """The solution with ``sigma`` (m) of noise beside the widths; ``weight`` (n,) scales each edge's say."""
    d, m = rows.X.shape[1], len(rows.labels)
    A = design(rows)
    sd = np.sqrt(rows.width**2 / 12.0 + rows.soft**2 + sigma**2 + 1e-16)
    weight = np.ones(len(sd)) if weight is None else weight
    before = precision_before(model, m)
    scale = np.sqrt(1.0 / (A.T**2 @ (weight / sd**2) + before))
    W = A * scale
    normal = (W.T * (weight / sd**2)) @ W + np.diag(scale**2 * before)
    theta = scale * np.linalg.solve(normal, W.T @ (weight / sd**2 * rows.middle))
    cov = np.linalg.inv(normal) * np.outer(scale, scale)
    rest = rows.middle - A @ theta
    return AveragingFit(theta[:d], theta[d:], cov, sigma, rest)


def of_ways(fit: AveragingFit, rows: Rows, model: LateralModel, correlation: Array) -> Array:
    """(d + m, d + m) covariance of ``fit``, which took each edge by itself, for edges whose noise has this
    ``correlation`` (n, n): that of any least squares whose weights are not those of the data (White 1982).
    What edges are off by together looks like a place of the tool: the noise seen in them is too small."""
    A, even = design(rows), rows.width**2 / 12.0 + rows.soft**2 + 1e-16
    gain = fit.cov @ (A / (even + fit.sigma**2)[:, None]).T
    before = fit.cov * precision_before(model, len(rows.labels))
    U, size, _ = np.linalg.svd(A / np.linalg.norm(A, axis=0), full_matrices=False)
    rest = np.eye(len(A)) - U[:, size > _NONE] @ U[:, size > _NONE].T
    noise = fit.sigma**2 * np.sum(rest**2) / max(np.sum(rest * correlation), _NONE)
    found: Array = gain @ (np.diag(even) + noise * correlation) @ gain.T + before @ fit.cov
    return 0.5 * (found + found.T)


def precision_before(model: LateralModel, edges: int) -> Array:
    """(d + m,) what is known of the unknowns and of the places of ``edges`` (m) before anything is seen."""
    found: Array = np.concatenate([np.minimum(model.prior_sd, 3.0 * model.trust), np.full(edges, 10.0)]) ** -2
    return found


def design(rows: Rows) -> Array:
    """(n, d + m): what each edge says of the unknowns and of the edges' places."""
    d = rows.X.shape[1]
    A = np.zeros((len(rows.low), d + len(rows.labels)))
    A[:, :d] = rows.X
    A[np.arange(len(rows.low)), d + rows.edge] = 1.0
    return A


def robust(rows: Rows, model: LateralModel) -> tuple[AveragingFit, NDArray[np.bool_]]:
    """The solution, and which rows are blunders: further off than width and noise of the others explain."""
    fit = average(rows, model)
    beyond = np.maximum(np.abs(fit.rest) - 0.5 * rows.width, 0.0)
    sigma = float(1.4826 * np.median(beyond))  # for a beginning: 0 where most are within
    for _ in range(_ROUNDS):
        u = fit.rest / (np.sqrt(rows.width**2 / 12.0 + rows.soft**2 + sigma**2 + 1e-16) * _TUKEY)
        weight = np.where(np.abs(u) < 1.0, (1.0 - u**2) ** 2, 1e-6)
        fit = average(rows, model, weight, sigma)
        sigma = excess(rows, fit.rest, weight)
    A = design(rows)
    known = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", A, fit.cov, A), 0.0))
    limit = 0.5 * rows.width + 5.0 * np.sqrt(sigma**2 + rows.soft**2) + 3.0 * known + 1e-7
    blunder = np.abs(fit.rest) > limit
    return fit, blunder


def excess(rows: Rows, rest: Array, weight: Array) -> float:
    """Noise (m) in the residuals beyond the intervals' widths; of edges that have a say.

    With it the residuals are as large as expected, each in units of its own width and noise (Paule and Mandel
    1982): next to one wide interval the squares of all narrow ones are lost in a plain sum."""
    freedom: float = max(float(np.sum(weight)) - rows.X.shape[1] - len(rows.labels), 1.0)
    even = rows.width**2 / 12.0 + rows.soft**2 + 1e-16

    def left(noise2: float) -> float:
        return float(np.sum(weight * rest**2 / (even + noise2))) - freedom

    if left(0.0) <= 0.0:
        return 0.0
    most = float(np.sum(weight * rest**2)) / freedom
    return float(np.sqrt(brentq(left, 0.0, most, xtol=1e-6 * most)))
