"""Ways that are off together, and what that leaves of a solution that took them one by one.

The arm comes to rest off by its repeatability, and under way it is off by a part of the standstill behind and
a part of the one ahead. So both edges of one way are off by nearly the same, which the solution knows, and of
two ways that have a standstill in common each has half of its variance from there, which it does not. A
solution that takes each way as off by itself is nearly the best one, but its covariance is too small: as that
of any least squares whose weights are not those of the data, it is ``G C G'`` with the gain ``G`` of the
solution and the true covariance ``C`` of the edges (Huber 1967, White 1982).
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from calibration.tool_frame.averaging import design, precision_before
from calibration.tool_frame.bounds import LateralModel, Rows
from calibration.tool_frame.posterior import WITHIN, Noise
from calibration.tool_frame.scene import Pass
from cell.poses import Array

SHARED = 0.5  # of a way's variance, from the standstill that it has in common with the next
_SAME_PLACE_M = 2e-4
_NONE = 1e-9  # of the largest singular value
_LEAST = 1e-3  # share of the intervals' variance


def as_they_are(
    rows: Rows, model: LateralModel, cov: Array, noise: Noise, neighbours: Sequence[tuple[int, int]]
) -> tuple[Array, Noise]:
    """What ways taken one by one gave, the covariance (d + m, d + m) and the noise, for ways of which
    ``neighbours`` share a standstill."""
    R, known = together(rows, neighbours, noise.within), one_by_one(rows, noise.within)
    # What the edges tell of the noise is told by fewer of them, and is too small; not what was known before.
    told = max(noise.spread**-2 - noise.spread_before**-2, 0.0)
    spread = float((told * fewer(known) / fewer(R) + noise.spread_before**-2) ** -0.5)
    sigma = noise.sigma * (unseen(rows, R) / unseen(rows, known)) ** (told * noise.spread**2)
    # Noise that may be larger is, in the mean of its square.
    larger = float(np.exp(max(spread**2 - noise.spread**2, 0.0)))
    found = widened(rows, model, cov, noise.sigma, sigma * larger, R, known)
    return found, Noise(sigma, spread, noise.spread_before, noise.within)


def in_a_row(passes: Mapping[int, Pass]) -> list[tuple[int, int]]:
    """Those of ``passes`` (by their places in the scene) with a standstill and nothing else between them."""
    found = []
    for a, b in pairwise(sorted(passes, key=lambda k: float(passes[k].pose_t[0]))):
        gap = passes[b].pose_xyz[0] - passes[a].pose_xyz[-1]
        if passes[a].current == passes[b].current and float(np.linalg.norm(gap)) < _SAME_PLACE_M:
            found.append((a, b))
    return found


def together(rows: Rows, neighbours: Sequence[tuple[int, int]], within: float = WITHIN) -> Array:
    """(n, n) correlation of what the arm does to the edges, of those of a way ``within``; ``neighbours`` are
    ways with one standstill."""
    places = np.unique(rows.source)
    number = {k: i for i, k in enumerate(places.tolist())}
    ways = within * np.eye(len(places))
    for a, b in neighbours:
        if a in number and b in number:
            ways[number[a], number[b]] = ways[number[b], number[a]] = SHARED * within
    own = np.searchsorted(places, rows.source)
    found: Array = ways[np.ix_(own, own)]
    np.fill_diagonal(found, 1.0)
    return found


def one_by_one(rows: Rows, within: float = WITHIN) -> Array:
    """(n, n) correlation of what the arm does to the edges, as a solution has it that knows ways alone; of
    the edges of a way ``within``."""
    return together(rows, (), within)


def fewer(R: Array) -> float:
    """By how much fewer edges, each off by itself, would tell the noise as well as those of correlation
    ``R`` (n, n)."""
    return float(np.mean(np.sum(R**2, axis=1)))


def unseen(rows: Rows, R: Array) -> float:
    """By what noise that shows in edges of correlation ``R`` (n, n) is too small: what neighbours are off by
    together is taken for a place of the tool."""
    A = design(rows)
    U, size, _ = np.linalg.svd(A / np.linalg.norm(A, axis=0), full_matrices=False)
    rest = np.eye(len(A)) - U[:, size > _NONE] @ U[:, size > _NONE].T
    return float(np.sqrt(np.sum(rest**2) / np.sum((rest @ R) * rest)))


def widened(
    rows: Rows, model: LateralModel, cov: Array, seen: float, sigma: float, R: Array, known: Array
) -> Array:
    """``cov`` (d + m, d + m), found with edges that are off by ``seen`` (m) with the correlation ``known``
    (n, n), for edges off by ``sigma`` (m) with the correlation ``R`` (n, n).

    Intervals laid over each other tell more than their middles: of their variance so much is counted that
    least squares is as good as ``cov``.
    """
    A, d = design(rows), rows.X.shape[1]
    scale = np.sqrt(np.diag(cov))
    A = A * scale
    stated: Array = cov / np.outer(scale, scale)
    before = np.diag(precision_before(model, A.shape[1] - d) * scale**2)
    even = rows.width**2 / 12.0 + rows.soft**2 + 1e-16

    def solved(share: float) -> tuple[Array, Array]:
        """Covariance and weighted design (d + m, n) of least squares with that ``share`` of the intervals'
        variance."""
        weighted = np.asarray(np.linalg.solve(np.diag(share * even) + seen**2 * known, A), dtype=float).T
        return np.asarray(np.linalg.inv(weighted @ A + before), dtype=float), weighted

    def excess(log_share: float) -> float:
        return float(np.linalg.slogdet(solved(float(np.exp(log_share)))[0][:d, :d])[1]) - wanted

    wanted = float(np.linalg.slogdet(stated[:d, :d])[1])
    share = float(np.exp(_between(excess, float(np.log(_LEAST)), 0.0)))
    alone, weighted = solved(share)
    G: Array = alone @ weighted
    as_one = G @ (np.diag(share * even) + sigma**2 * R) @ G.T + alone @ before @ alone
    turn = np.asarray(np.linalg.solve(_root(alone).T, _root(stated).T).T, dtype=float)
    found: Array = turn @ as_one @ turn.T * np.outer(scale, scale)
    return 0.5 * (found + found.T)


def _between(rising: Callable[[float], float], low: float, high: float) -> float:
    """Where ``rising`` is zero, or the end that is nearest to it."""
    if rising(high) <= 0.0:
        return high
    return low if rising(low) >= 0.0 else float(brentq(rising, low, high, xtol=0.01))


def _root(cov: Array) -> Array:
    return np.asarray(np.linalg.cholesky(cov + 1e-9 * np.diag(np.diag(cov))), dtype=float)
