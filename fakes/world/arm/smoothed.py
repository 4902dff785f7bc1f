"""Joint polynomials seen through a low-pass of first order, in closed form: nothing ticks on virtual time."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from cell.poses import Array
from fakes.world.arm.segments import Polynomial

_SETTLED = 12.0  # time constants until the arm is where it was sent: 6e-6 of the way are left


@dataclass(frozen=True)
class _Phase:
    """From ``t0`` on: a polynomial in ``t - origin``, and what is left of how the phase began."""

    t0: float
    origin: float
    coefficients: Array  # (k, 6)
    left: Array  # (6,)

    def at(self, t: float, tau: float) -> tuple[Array, Array]:
        s, k = t - self.origin, np.arange(len(self.coefficients))
        c, left = self.coefficients, self.left * np.exp((self.t0 - t) / tau)
        return s**k @ c + left, (k[1:] * s ** k[:-1]) @ c[1:] - left / tau


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The arm on its way after ``sent``, later by ``tau`` on a steady way; it began at ``q0`` (6,)."""

    settles: ClassVar[bool] = False
    sent: Polynomial
    tau: float
    q0: Array

    @property
    def t0(self) -> float:
        return self.sent.t0

    def __reduce__(self) -> tuple[type["Smoothed"], tuple[Polynomial, float, Array]]:
        """Without what can be computed again."""
        return Smoothed, (self.sent, self.tau, self.q0)

    @cached_property
    def t_end(self) -> float:
        return self.sent.t_end + _SETTLED * self.tau

    def at(self, t: float) -> tuple[Array, Array]:
        if t >= self.t_end:
            return self.sent.at(self.sent.t_end)
        phase = next((p for p in reversed(self._phases) if p.t0 <= t), self._phases[0])
        return phase.at(t, self.tau)

    def acceleration(self, t: float) -> Array:
        """Of the joints (6,), rad/s^2."""
        if t >= self.t_end:
            return np.zeros_like(self.q0)
        return (self.sent.at(t)[1] - self.at(t)[1]) / self.tau

    @cached_property
    def _phases(self) -> list[_Phase]:
        """What was sent, the braking at its end, and the rest after that."""
        sent, t1, over = self.sent, self.sent.t1, self.sent.t_end
        q1, qd1 = sent.at(t1)
        rest = sent.at(over)[0]
        pieces = [(sent.t0, sent.origin, sent.coefficients)]
        if over > t1:
            pieces.append((t1, t1, np.array([q1, qd1, -0.5 * qd1 / (over - t1)])))
        pieces.append((over, over, rest[None, :]))
        phases: list[_Phase] = []
        q = self.q0
        for t0, origin, coefficients in pieces:
            if phases:
                q = phases[-1].at(t0, self.tau)[0]
            steady = self._steady(coefficients)
            k = np.arange(len(steady))
            phases.append(_Phase(t0, origin, steady, q - (t0 - origin) ** k @ steady))
        return phases

    def _steady(self, sent: Array) -> Array:
        """Of ``y + tau y' = sent``: the solution that is a polynomial too."""
        out = np.array(sent, dtype=float)
        for k in range(len(out) - 2, -1, -1):
            out[k] -= self.tau * (k + 1) * out[k + 1]
        return out
