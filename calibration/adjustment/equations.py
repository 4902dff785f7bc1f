"""Normal equations of a weighted adjustment with global unknowns, one local pose a group, and priors.

Minimised is ``sum r^T V^-1 r`` over the observations, plus what images say of the global unknowns by
themselves, plus ``x^T S^-1 x`` of the priors. An observation touches the global unknowns and the pose of its
own group, so every local pose is eliminated by itself (Schur complement) and no matrix grows with the
number of groups.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye.noise import inverse_spd
from calibration.hand_eye.normal import each_group, row_blocks
from cell.poses import Array

_NOTHING = 1e-100  # information below this would overflow when it is scaled to one


class ByRows(Protocol):
    """(n, d, m) numbers of which some rows at a time are asked for: an array, or what makes them then."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __getitem__(self, rows: slice, /) -> Array: ...


@dataclass(frozen=True)
class Observations:
    """n linearised observations of d numbers, over m global unknowns and a local pose each.

    ``r`` (n, d) are the residuals, ``of_global`` (n, d, m) and ``of_local`` (n, d, 6) their derivatives,
    ``group`` (n,) counts the local poses from 0. ``parts`` (k, n, d, d): covariance of a residual for a unit
    of each kind of noise. What has one noise alone may be held as sums: ``info`` (m, m) and ``pull`` (m,) are
    curvature and gradient of half the squared residuals ``sse`` by the global unknowns, and ``dof`` is how
    many they are. Of images these are the pixels, at the images' best poses, less what those poses take up.
    """

    r: Array
    of_global: ByRows
    of_local: Array
    group: NDArray[np.int64]
    parts: Array
    info: Array
    pull: Array
    sse: float
    dof: float

    @classmethod
    def of_sums(cls, A: Array, r: Array) -> "Observations":
        """Residuals ``r`` (k,) with derivatives ``A`` (m, k), all of one size of noise, as sums alone."""
        m = len(A)
        return cls(
            r=np.zeros((0, 1)),
            of_global=np.zeros((0, 1, m)),
            of_local=np.zeros((0, 1, 6)),
            group=np.zeros(0, dtype=np.int64),
            parts=np.zeros((1, 0, 1, 1)),
            info=A @ A.T,
            pull=A @ r,
            sse=float(r @ r),
            dof=float(len(r)),
        )

    def of_unknowns(self, which: NDArray[np.int64]) -> "Observations":
        """With some of the global unknowns alone; of observations that are sums alone."""
        return replace(
            self,
            of_global=np.zeros((0, 1, len(which))),
            info=self.info[np.ix_(which, which)],
            pull=self.pull[which],
        )

    def squares(self, x: Array) -> float:
        """Of the residuals that are held as sums, after the change ``x`` (m,)."""
        return float(self.sse + 2.0 * self.pull @ x + x @ self.info @ x)

    @property
    def n(self) -> int:
        return len(self.r)

    @property
    def groups(self) -> int:
        return int(self.group.max()) + 1 if self.n else 0


@dataclass(frozen=True)
class Prior:
    """Standard deviations ``sigma`` (m,) of the global unknowns about ``mean`` (m,), inf where there is none.

    ``blocks`` names slices of unknowns that share a scale.
    """

    mean: Array
    sigma: Array
    blocks: dict[str, slice]

    def scaled(self, scale: dict[str, float]) -> "Prior":
        """With the standard deviations of some blocks times a factor."""
        sigma = self.sigma.copy()
        for name, factor in scale.items():
            sigma[self.blocks[name]] *= factor
        return replace(self, sigma=sigma)

    @cached_property
    def precision(self) -> Array:
        """(m,), zero where there is no prior."""
        return np.asarray(np.where(np.isfinite(self.sigma), self.sigma**-2.0, 0.0))


@dataclass(frozen=True)
class Equations:
    """The equations with every local pose eliminated.

    ``N`` (m, m) and ``g`` (m,) are those of the global unknowns, prior included. ``inverse`` (g, 6, 6) is
    that of the local blocks, ``carry`` (g, 6, m) takes a global change to the local one that follows it, and
    ``local`` (g, 6) is the local change when no global unknown moves. ``weight`` (n, d, d) is V^-1.
    """

    N: Array
    g: Array
    inverse: Array
    carry: Array
    local: Array
    weight: Array

    @cached_property
    def covariance(self) -> Array:
        """(m, m) of the global unknowns. Directions without any information have an infinite variance."""
        s, values, vectors, known = self._parts
        out = s[:, None] * ((vectors[:, known] / values[known]) @ vectors[:, known].T) * s
        is_open = (s == 0.0) | (np.sum(vectors[:, ~known] ** 2, axis=1) > 1e-6)
        out[is_open, is_open] = np.inf
        return np.asarray(out)

    @property
    def log_determinant(self) -> float:
        """Of ``N``, without directions of which nothing is known."""
        s, values, _, known = self._parts
        return float(np.sum(np.log(values[known])) - 2.0 * np.sum(np.log(s[s > 0.0])))

    def step(self) -> tuple[Array, Array]:
        """The change that minimises the linear problem: global (m,) and local (g, 6).

        A direction without information does not move.
        """
        s, values, vectors, known = self._parts
        x = -s * (vectors[:, known] @ (vectors[:, known].T @ (s * self.g) / values[known]))
        return x, -self.local - self.carry @ x

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Scales (m,) that bring ``N`` to a unit diagonal, its eigenvalues and eigenvectors then, and which
        of them the data or the prior tell anything of."""
        diagonal = np.diag(self.N)
        s = np.where(diagonal > _NOTHING, 1.0 / np.sqrt(np.maximum(diagonal, _NOTHING)), 0.0)
        values, vectors = np.linalg.eigh(self.N * s[:, None] * s)
        return s, values, vectors, values > 1e-13 * max(float(values[-1]), _NOTHING)

    def follows(self, obs: Observations, rows: slice) -> Array:
        """(k, d, m) derivatives of some residuals by the global unknowns, whose local poses follow."""
        return np.asarray(obs.of_global[rows] - obs.of_local[rows] @ self.carry[obs.group[rows]])

    def left(self, obs: Observations, rows: slice, follows: Array, x: Array) -> Array:
        """(k, d) of some residuals after the change ``x`` (m,), whose derivatives are ``follows``."""
        local = self.local[obs.group[rows]]
        out: Array = obs.r[rows] - (obs.of_local[rows] @ local[..., None])[..., 0] + follows @ x
        return out

    def local_covariance(self) -> Array:
        """(g, 6, 6) of the local poses."""
        out: Array = self.inverse + self.carry @ self.covariance @ np.swapaxes(self.carry, 1, 2)
        return out

    def local_cross(self) -> Array:
        """(g, 6, m) covariance of the local poses with the global unknowns."""
        return -self.carry @ self.covariance


def equations(obs: Observations, V: Array, variance_of_sums: float, prior: Prior, at: Array) -> Equations:
    """Of ``obs`` with covariances ``V`` (n, d, d) and one variance for their sums, at ``at`` (m,)."""
    weight = inverse_spd(V)
    m = obs.of_global.shape[2]
    N, g = np.zeros((m, m)), np.zeros(m)
    groups = obs.groups
    LL, LG, gl = np.zeros((groups, 6, 6)), np.zeros((groups, 6, m)), np.zeros((groups, 6))
    for rows in row_blocks(obs.n):
        G, L, P, r = obs.of_global[rows], obs.of_local[rows], weight[rows], obs.r[rows]
        PG, PL = P @ G, P @ L
        Pr = (P @ r[..., None])[..., 0]
        for one, own in each_group(obs.group[rows]):
            Lt = L[own].reshape(-1, 6).T
            LL[one] += Lt @ PL[own].reshape(-1, 6)
            LG[one] += Lt @ PG[own].reshape(-1, m)
            gl[one] += Lt @ Pr[own].ravel()
        flat = G.reshape(-1, m)
        N += flat.T @ PG.reshape(-1, m)
        g += flat.T @ Pr.ravel()
    inverse = inverse_spd(LL)
    carry = inverse @ LG
    local = (inverse @ gl[..., None])[..., 0]
    N -= LG.reshape(-1, m).T @ carry.reshape(-1, m)
    g -= np.einsum("gim,gi->m", LG, local)
    N += obs.info / variance_of_sums + np.diag(prior.precision)
    g += obs.pull / variance_of_sums + prior.precision * (at - prior.mean)
    return Equations(0.5 * (N + N.T), g, inverse, carry, local, weight)
