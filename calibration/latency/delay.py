"""A delay as it was found, and what leaving out parts of the data says of its uncertainty."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtrix, ndtri, stdtrit

from cell.poses import Array

Z95 = float(ndtri(0.975))


class DelayUndetermined(ValueError):
    """The data do not tell the delay; begins with a fixed name."""


@dataclass(frozen=True, eq=False)
class Delay:
    """``tau`` (s) and ``hysteresis`` (m; None where it is part of ``tau``, or there is none), with sigmas.

    ``residuals`` (n,) m belong to the readings; ``heldout`` (n,) m likewise, each by a solution that did not
    see it; ``scatter`` is the residuals' RMS over what their brackets explain (1 is expected; None without
    brackets). ``bias`` (s) is the most that ``tau`` is off by what all readings have alike, and more readings
    do not narrow. The 95 % interval reaches ``half95`` to either side: ``sigmas`` of ``sigma_tau``, and more
    with a ``bias``.
    """

    tau: float
    sigma_tau: float
    hysteresis: float | None
    sigma_hysteresis: float | None
    residuals: Array
    heldout: Array
    scatter: float | None
    sigmas: float = Z95
    bias: float = 0.0

    @property
    def half95(self) -> float:
        """Half of the 95 % interval, s; it holds where every answer is off by all of ``bias``, too."""
        if not self.bias:
            return self.sigmas * self.sigma_tau
        sigma = self.sigma_tau * self.sigmas / Z95
        # The square of a normal number about a mean is noncentral chi-square.
        return sigma * float(np.sqrt(chndtrix(0.95, 1.0, (self.bias / sigma) ** 2)))

    @property
    def interval95(self) -> tuple[float, float]:
        """Where ``tau`` is with 95 % probability, s."""
        return self.tau - self.half95, self.tau + self.half95


@dataclass(frozen=True)
class LeftOut:
    """By leaving out one group after the other: ``cov`` (p, p) of the unknowns, residuals ``heldout`` (n,),
    and ``sigmas``, half of a 95 % interval in standard deviations."""

    cov: Array
    heldout: Array
    sigmas: float


def leave_out(J: Array, r: Array, group: NDArray[np.int64], prior: Array | None = None) -> LeftOut:
    """At a least-squares solution with derivatives ``J`` (n, p), residuals ``r`` (n,) and groups (n,).

    Errors that a group shares, whatever their cause, are in ``cov`` as they are; noise levels need not be
    known. ``prior`` (p,) is the precision that is added for each unknown. Source: Efron and Stein, The
    Jackknife Estimate of Variance, Ann. Stat. 9 (1981), with groups.
    """
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    white = J / scale
    N = white.T @ white + np.diag((0.0 if prior is None else prior) / scale**2 * np.ones(J.shape[1]))
    names = np.unique(group)
    changes, heldout = np.empty((len(names), J.shape[1])), np.empty(len(r))
    for k, name in enumerate(names):
        own = group == name
        left = N - white[own].T @ white[own]
        change = -np.linalg.pinv(left, rcond=1e-12, hermitian=True) @ (white[own].T @ r[own])
        heldout[own] = r[own] - white[own] @ change
        changes[k] = change / scale
    off = changes - changes.mean(axis=0)
    count = len(names)
    return LeftOut((count - 1.0) / count * off.T @ off, heldout, float(stdtrit(count - 1.0, 0.975)))
