"""Speed profiles along one path coordinate: how far along at a time, and how fast."""

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

_END_S = 1e-9  # this near the end counts as the end, so that rest is exactly zero speed


@dataclass(frozen=True)
class Trapezoid:
    """From rest to rest over ``length`` with at most speed ``v`` and acceleration ``a``."""

    length: float
    v: float
    a: float

    def __post_init__(self) -> None:
        if not (self.length >= 0.0 and self.v > 0.0 and self.a > 0.0):
            raise ValueError(f"a move needs positive speed and acceleration, got v={self.v}, a={self.a}")

    @cached_property
    def peak(self) -> float:
        """The speed that is reached; a short move never gets to ``v``."""
        return min(self.v, sqrt(self.length * self.a))

    @cached_property
    def duration(self) -> float:
        """Seconds from rest to rest."""
        return self.length / self.peak + self.peak / self.a if self.length > 0.0 else 0.0

    def at(self, tau: float) -> tuple[float, float]:
        """Distance and speed ``tau`` seconds after the start; clamped to both ends."""
        if tau <= 0.0:
            return 0.0, 0.0
        left = self.duration - tau
        if left <= _END_S:
            return self.length, 0.0
        ramp = self.peak / self.a
        if tau < ramp:
            return 0.5 * self.a * tau * tau, self.a * tau
        if left < ramp:
            return self.length - 0.5 * self.a * left * left, self.a * left
        return self.peak * (tau - 0.5 * ramp), self.peak


@dataclass(frozen=True)
class Ramp:
    """From distance ``s0`` and speed ``v0`` down to rest with deceleration ``a``."""

    s0: float
    v0: float
    a: float

    @cached_property
    def duration(self) -> float:
        """Seconds until rest."""
        return abs(self.v0) / self.a

    def at(self, tau: float) -> tuple[float, float]:
        """Distance and speed ``tau`` seconds after the start of the ramp."""
        T = self.duration
        if T == 0.0 or tau <= 0.0:
            return self.s0, self.v0
        tau = T if T - tau < _END_S else tau
        return self.s0 + self.v0 * (tau - 0.5 * tau * tau / T), self.v0 * (1.0 - tau / T)
