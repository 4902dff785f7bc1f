"""Pieces of an arm's motion. Each is a pickleable value that is defined for every time from ``t0`` on and
comes to rest by itself (only :class:`JointSpeed` runs until something else follows)."""

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import ClassVar, Protocol

import numpy as np

from cell.poses import Array
from fakes.world.arm.profile import Ramp, Trapezoid

SERVO_REST_RAD_S2 = 8.0  # how hard the arm brakes when set-points stop coming


def largest(values: Array) -> float:
    """The largest magnitude; of so few numbers Python has it sooner than NumPy."""
    numbers: list[float] = values.tolist()
    return max(map(abs, numbers))


class Segment(Protocol):
    """``at(t)`` gives joints (rad) and joint speeds (rad/s), both (6,), for ``t >= t0``.

    ``settles`` says that the end of this segment is a standstill of its own, so repeatability is drawn anew.
    """

    settles: ClassVar[bool]

    @property
    def t0(self) -> float: ...
    @property
    def t_end(self) -> float: ...
    def at(self, t: float) -> tuple[Array, Array]: ...


@dataclass(frozen=True, eq=False)
class Hold:
    """Standing still at ``q``."""

    settles: ClassVar[bool] = False
    t0: float
    q: Array

    @property
    def t_end(self) -> float:
        return self.t0

    def at(self, t: float) -> tuple[Array, Array]:
        return self.q.copy(), np.zeros_like(self.q)


@dataclass(frozen=True, eq=False)
class JointMove:
    """All joints together on a straight line in joint space; the profile is the longest-moving joint's.

    ``gone_s`` of the profile were over at ``t0``: the move goes on after an interruption.
    """

    settles: ClassVar[bool] = True
    t0: float
    q0: Array
    q1: Array
    profile: Trapezoid
    gone_s: float = 0.0

    @property
    def begun(self) -> float:
        """When the profile would have begun without an interruption."""
        return self.t0 - self.gone_s

    @property
    def t_end(self) -> float:
        return self.begun + self.profile.duration

    def at(self, t: float) -> tuple[Array, Array]:
        s, v = self.profile.at(t - self.begun)
        if s >= self.profile.length:
            return self.q1.copy(), np.zeros_like(self.q1)
        per_length = (self.q1 - self.q0) / self.profile.length
        return self.q0 + per_length * s, per_length * v


@dataclass(frozen=True, eq=False)
class PathMove:
    """Joints along a spline ``q(s)``, travelled with a profile; a stop is the same path with a ramp.

    ``knots`` (n,) are path lengths, ``coefficients`` (4, n-1, 6) cubic pieces, highest power first.
    ``gone_s`` of the profile were over at ``t0``.
    """

    settles: ClassVar[bool] = True
    t0: float
    knots: Array
    coefficients: Array
    profile: Trapezoid | Ramp
    gone_s: float = 0.0

    @property
    def begun(self) -> float:
        """When the profile would have begun without an interruption."""
        return self.t0 - self.gone_s

    @property
    def t_end(self) -> float:
        return self.begun + self.profile.duration

    def __reduce__(self) -> tuple[type["PathMove"], tuple[float, Array, Array, Trapezoid | Ramp, float]]:
        """Without what can be computed again."""
        return PathMove, (self.t0, self.knots, self.coefficients, self.profile, self.gone_s)

    @cached_property
    def _lengths(self) -> list[float]:
        lengths: list[float] = self.knots.tolist()
        return lengths

    @cached_property
    def _pieces(self) -> list[Array]:
        return list(self.coefficients.swapaxes(0, 1))

    def at(self, t: float) -> tuple[Array, Array]:
        s, v = self.profile.at(t - self.begun)
        knots = self._lengths
        i = min(max(bisect_right(knots, s) - 1, 0), len(knots) - 2)
        c3, c2, c1, c0 = self._pieces[i]
        x = s - knots[i]
        return ((c3 * x + c2) * x + c1) * x + c0, ((3.0 * c3 * x + 2.0 * c2) * x + c1) * v


@dataclass(frozen=True, eq=False)
class JointStop:
    """Braking in the direction of motion; ``decel`` (rad/s^2) holds for the fastest joint."""

    settles: ClassVar[bool] = True
    t0: float
    q0: Array
    qd0: Array
    decel: float

    @property
    def t_end(self) -> float:
        return self.t0 + float(np.max(np.abs(self.qd0))) / self.decel

    def at(self, t: float) -> tuple[Array, Array]:
        return _brake(self.q0, self.qd0, self.decel, t - self.t0)


@dataclass(frozen=True, eq=False)
class JointSpeed:
    """Changing to joint speeds ``qd1`` with ``accel`` (rad/s^2, the joint that changes most), then keeping
    them."""

    settles: ClassVar[bool] = False
    t0: float
    q0: Array
    qd0: Array
    qd1: Array
    accel: float

    @property
    def _ramp_s(self) -> float:
        return float(np.max(np.abs(self.qd1 - self.qd0))) / self.accel

    @property
    def t_end(self) -> float:
        return inf if np.any(self.qd1) else self.t0 + self._ramp_s

    def at(self, t: float) -> tuple[Array, Array]:
        tau, ramp = max(t - self.t0, 0.0), self._ramp_s
        if tau >= ramp:
            mean = 0.5 * (self.qd0 + self.qd1)
            return self.q0 + mean * ramp + self.qd1 * (tau - ramp), self.qd1.copy()
        qd = self.qd0 + (self.qd1 - self.qd0) * (tau / ramp)
        return self.q0 + 0.5 * (self.qd0 + qd) * tau, qd


@dataclass(frozen=True, eq=False)
class Polynomial:
    """``q(t) = sum_k coefficients[k] (t - origin)^k`` from ``t0`` to ``t1``; braking when nothing follows.

    Servo set-points become cubics of this form.
    """

    settles: ClassVar[bool] = False
    t0: float
    t1: float
    origin: float
    coefficients: Array  # (degree + 1, 6)

    def __reduce__(self) -> tuple[type["Polynomial"], tuple[float, float, float, Array]]:
        """Without what can be computed again: 500 of them a second go to the camera's process."""
        return Polynomial, (self.t0, self.t1, self.origin, self.coefficients)

    def paced(self, since: float, t: float, rate: float) -> "Polynomial":
        """The same way, ``rate`` times as fast from where it is at ``since``, which it is at ``t``."""
        t0, t1, origin = (t + (time - since) / rate for time in (max(self.t0, since), self.t1, self.origin))
        slowed = self.coefficients * (rate ** np.arange(len(self.coefficients)))[:, None]
        return Polynomial(t0, t1, origin, slowed if rate != 1.0 else self.coefficients)

    @cached_property
    def t_end(self) -> float:
        return self.t1 + largest(self.end[1]) / SERVO_REST_RAD_S2

    def at(self, t: float) -> tuple[Array, Array]:
        if t <= self.t1:
            return self._inside(t)
        return _brake(*self.end, SERVO_REST_RAD_S2, t - self.t1)

    def acceleration(self, t: float) -> Array:
        """Of the joints (6,), rad/s^2."""
        if t > self.t1:
            return -self.end[1] / (self.t_end - self.t1) if t < self.t_end else np.zeros_like(self.end[1])
        bends, power = [], 1.0
        for k in range(2, len(self.coefficients)):
            bends.append(k * (k - 1) * power)
            power *= t - self.origin
        return np.dot(bends, self.coefficients[2:]) if bends else np.zeros(self.coefficients.shape[1])

    @cached_property
    def end(self) -> tuple[Array, Array]:
        """Joints and joint speeds at ``t1``, to be read only."""
        return self._inside(self.t1)

    def _inside(self, t: float) -> tuple[Array, Array]:
        powers = [1.0]
        for _ in range(len(self.coefficients) - 1):
            powers.append(powers[-1] * (t - self.origin))
        rates = [k * power for k, power in enumerate(powers[:-1], start=1)]
        c = self.coefficients
        return np.dot(powers, c), np.dot(rates, c[1:]) if rates else np.zeros(c.shape[1])


def _brake(q: Array, qd: Array, decel: float, tau: float) -> tuple[Array, Array]:
    T = largest(qd) / decel
    if T == 0.0:
        return q.copy(), np.zeros_like(q)
    tau = T if T - tau < 1e-9 else max(tau, 0.0)
    return q + qd * (tau - 0.5 * tau * tau / T), qd * (1.0 - tau / T)
