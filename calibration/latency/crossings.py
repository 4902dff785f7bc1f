"""The delay of a switching input against the arm, from crossings in both directions at several speeds.

An edge that is seen ``tau`` late appears ``v tau`` further along the way; a switch that clears later than it
breaks (hysteresis ``h``) shifts every edge by ``h/2`` along the way, whatever the speed. So the position of
edge k of a tool on a way in direction d = +1 or -1 is ``x = e_k + d (v tau + h/2)``: linear in the places
``e_k``, ``tau`` and ``h``. Two directions tell ``e_k`` from the rest, two speeds tell ``tau`` from ``h``.
The delay of beams falls out of the passes out and back.

A poll looks at some time between its request and its reply. Where is the module's way to work, and much the
same for all polls: it shifts all edges alike, which is no scatter, and no number of passes takes it out. The
edges of one way are not independent either: a tool whose width takes a whole number of polls has all of them
at the same place between two.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from calibration.latency.delay import Delay, DelayUndetermined, leave_out
from cell.poses import Array

ONE_SPEED = 1.2  # ratio of speeds below which tau and h cannot be told apart


@dataclass(frozen=True)
class SeenCrossing:
    """One edge as it was seen.

    ``place`` numbers the edges of the tool in space, ``direction`` is 1 or -1, ``speed`` (m/s, positive) that
    of the arm, ``x`` (m) where the arm was along the way out when the edge was seen, ``dt`` (s) half of the
    time between the two looks that the edge lies between, and ``look`` (s) by how much the two may be off.
    ``way`` numbers the ways.
    """

    way: int
    place: int
    direction: int
    speed: float
    x: float
    dt: float
    look: float = 0.0

    @property
    def sigma(self) -> float:
        """Standard deviation of ``x``, m: the edge is anywhere between its looks with equal probability, and
        each look anywhere in its own time."""
        return self.speed * hypot(self.dt, self.look) / sqrt(3.0)


def undetermined(crossings: Sequence[SeenCrossing]) -> str | None:
    """Why the delay cannot be found from these crossings, beginning with a fixed name, or None."""
    ways = {(c.place, c.direction) for c in crossings}
    places = {c.place for c in crossings}
    if any((p, d) not in ways for p in places for d in (1, -1)) or not places:
        return (
            "one-way: each edge of the tool must be crossed out and back, or the delay is part of its place"
        )
    if len(crossings) < len(places) + 4:
        return f"too-few-passes: {len(crossings)} edges were seen, {len(places) + 4} are needed"
    return None


def solve_delay(crossings: Sequence[SeenCrossing]) -> Delay:
    """Weighted least squares; ``DelayUndetermined`` when :func:`undetermined` says why it cannot be."""
    if (why := undetermined(crossings)) is not None:
        raise DelayUndetermined(why)
    A, x, weight = _system(crossings)
    theta, cov = _fit(A, x, weight)
    residuals = x - A @ theta
    freedom = len(x) - A.shape[1]
    scatter = float(np.sqrt(np.sum((residuals * weight) ** 2) / freedom))
    cov_known = cov * max(scatter, 1.0) ** 2  # brackets are known; what exceeds them is not
    left = leave_out(A * weight[:, None], residuals * weight, np.array([c.way for c in crossings]))
    sigma = np.sqrt(np.maximum(np.diag(left.cov), np.diag(cov_known)))
    with_h = _several_speeds(crossings)
    tau = A.shape[1] - (2 if with_h else 1)
    alike = np.array([c.direction * c.speed * c.look for c in crossings])  # m, each edge off by all of it
    return Delay(
        float(theta[tau]),
        float(sigma[tau]),
        float(theta[-1]) if with_h else None,
        float(sigma[-1]) if with_h else None,
        residuals,
        left.heldout / weight,
        scatter,
        left.sigmas,
        bias=abs(float(cov[tau] @ (A.T * weight**2) @ alike)),
    )


def _several_speeds(crossings: Sequence[SeenCrossing]) -> bool:
    speeds = [c.speed for c in crossings]
    return max(speeds) > ONE_SPEED * min(speeds)


def _system(crossings: Sequence[SeenCrossing]) -> tuple[Array, Array, Array]:
    """Design (n, places + 1 or 2), positions (n,) m and weights (n,) 1/m."""
    places = sorted({c.place for c in crossings})
    columns = [[float(c.place == p) for c in crossings] for p in places]
    columns.append([c.direction * c.speed for c in crossings])
    if _several_speeds(crossings):
        columns.append([0.5 * c.direction for c in crossings])
    weight = 1.0 / np.array([c.sigma for c in crossings])
    return np.array(columns).T, np.array([c.x for c in crossings]), weight


def _fit(A: Array, x: Array, weight: Array) -> tuple[Array, Array]:
    scale = np.linalg.norm(A * weight[:, None], axis=0)
    W = A * weight[:, None] / scale
    theta, *_ = np.linalg.lstsq(W, x * weight, rcond=None)
    return theta / scale, np.linalg.inv(W.T @ W) / np.outer(scale, scale)
