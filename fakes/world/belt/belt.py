"""A belt whose travel is an exact function of time: pieces of linear speed under a ripple.

    v(t) = (v0 + a (t - t0)) (1 + sum_k A_k sin(w_k (t - begin) + phi_k))

has its integral in closed form, so nothing depends on how often somebody looks.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import cos, inf, pi, sin

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array
from fakes.world.belt.truth import BeltTruth

Order = tuple[float, float | None, float]  # when, the speed from then on (None: the profile's), acceleration


@dataclass(frozen=True)
class Piece:
    """From ``t0`` on: travel ``x0`` (m), then base speed ``v0`` (m/s) that changes by ``a`` (m/s2)."""

    t0: float
    x0: float
    v0: float
    a: float

    def base_speed(self, t: float) -> float:
        """The speed without its ripple."""
        return self.v0 + self.a * (t - self.t0)


class Belt:
    """Travel since the world began, m along ``dir``; the operator's orders come in the order of time."""

    def __init__(self, truth: BeltTruth, seed: int, begin: float) -> None:
        self.truth, self.begin = truth, begin
        self.listeners: list[Callable[[Order], None]] = []
        self._seed = seed
        self._waves = [(r.amplitude, 2.0 * pi * r.hz, r.phase_rad) for r in truth.ripple]
        self._load([])

    # -- where it is

    def travel_at(self, t: float) -> float:
        """Metres that the belt has moved by ``t`` (s)."""
        piece = self._piece(t)
        tau = t - piece.t0
        even = piece.v0 * tau + 0.5 * piece.a * tau * tau
        return piece.x0 + even + self._wave(piece, t) - self._wave(piece, piece.t0)

    def speed_at(self, t: float) -> float:
        """Its speed at ``t``, m/s."""
        piece = self._piece(t)
        ripple = sum(a * sin(w * (t - self.begin) + phi) for a, w, phi in self._waves)
        return piece.base_speed(t) * (1.0 + ripple)

    @cached_property
    def direction(self) -> Array:
        """(3,) unit vector of positive travel, in the base."""
        way = np.array(self.truth.dir)
        return np.asarray(way / np.linalg.norm(way))

    @cached_property
    def T_base_belt(self) -> RigidTransform:
        """The belt's frame, which does not move: x along the travel, z up as far as that allows."""
        x = self.direction
        up = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        y = np.cross(up, x)
        y /= np.linalg.norm(y)
        axes = np.stack([x, y, np.cross(x, y)], axis=1)
        return RigidTransform.from_components(self.truth.origin, Rotation.from_matrix(axes))

    # -- what the operator does

    def run(self, t: float, speed_m_s: float, accel_m_s2: float = 0.6) -> None:
        """From ``t`` on go to this speed and keep it, whatever the profile says; 0 stops."""
        self.follow((t, speed_m_s, accel_m_s2))

    def resume(self, t: float, accel_m_s2: float = 0.6) -> None:
        """Begin the profile again at ``t``."""
        self.follow((t, None, accel_m_s2))

    def orders(self) -> list[Order]:
        """What was ordered, oldest first; :meth:`load` of another belt makes it run alike."""
        return list(self._orders)

    def load(self, begin: float, orders: list[Order]) -> None:
        """Become a copy of the belt that began to run at ``begin`` and has these :meth:`orders`."""
        self.begin = begin
        self._load(orders)

    def follow(self, order: Order) -> None:
        """Carry out an order."""
        t, speed, accel = order
        self._orders.append(order)
        piece = self._piece(t)
        x, v = self.travel_at(t), piece.base_speed(t)
        del self._pieces[bisect_right(self._pieces, t, key=_begin) :]
        del self._ends[len(self._pieces) :]
        self._ends[-1] = t
        if speed is None:
            self._phases = self._profile(accel, len(self._orders))
        else:
            self._phases = iter([(speed, accel, 0.0, inf)])
        self._state = (t, x, v)
        for listener in tuple(self.listeners):
            listener(order)

    # -- how it comes about

    def _load(self, orders: list[Order]) -> None:
        self._orders: list[Order] = []
        self._pieces: list[Piece] = []
        self._ends: list[float] = []
        self._phases = self._profile(None, 0)
        self._state = (self.begin, 0.0, self.truth.profile[0].speed_m_s)
        for order in orders:
            self.follow(order)

    def _profile(self, first_accel: float | None, draw: int) -> Iterator[tuple[float, float, float, float]]:
        """Speed, acceleration to it, creep and duration of one phase after the other."""
        generator = np.random.default_rng([self._seed, 66, draw])
        while True:
            for phase in self.truth.profile:
                accel, first_accel = first_accel or phase.accel_m_s2, None
                left = phase.for_s or inf
                stops = self.truth.stops
                while stops is not None and phase.speed_m_s and left > 0.0:
                    runs = min(float(generator.uniform(*stops.every_s)), left)
                    left -= runs
                    yield phase.speed_m_s, accel, phase.creep_per_s, runs
                    down = float(generator.uniform(*stops.accel_m_s2))
                    accel = float(generator.uniform(*stops.accel_m_s2))
                    yield 0.0, down, 0.0, float(generator.uniform(*stops.held_s))
                if left > 0.0:
                    yield phase.speed_m_s, accel, phase.creep_per_s, left
            if not self.truth.repeat:
                return

    def _piece(self, t: float) -> Piece:
        while not self._ends or self._ends[-1] <= t:
            if not self._extend():
                break
        return self._pieces[max(bisect_right(self._pieces, t, key=_begin) - 1, 0)]

    def _extend(self) -> bool:
        """Append the pieces of one more phase; False when there is none, and the last speed stays."""
        phase = next(self._phases, None)
        if phase is None:
            if not self._ends or self._ends[-1] == inf:
                return False
            phase = (self._state[2], 1.0, 0.0, inf)
        speed, accel, creep, duration = phase
        t, x, v = self._state
        if ramp := abs(speed - v) / accel:
            t, x, v = self._append(Piece(t, x, v, (speed - v) / ramp), t + ramp, speed)
        end = t + duration
        last = speed * (1.0 + creep * duration) if creep else speed
        self._state = self._append(Piece(t, x, v, speed * creep), end, last)
        return True

    def _append(self, piece: Piece, end: float, v: float) -> tuple[float, float, float]:
        self._pieces.append(piece)
        self._ends.append(end)
        if end == inf:
            return end, 0.0, v
        tau = end - piece.t0
        even = piece.v0 * tau + 0.5 * piece.a * tau * tau
        return end, piece.x0 + even + self._wave(piece, end) - self._wave(piece, piece.t0), v

    def _wave(self, piece: Piece, t: float) -> float:
        """The integral of the ripple's part of the speed, up to a constant."""
        v, s = piece.base_speed(t), t - self.begin
        return sum(
            A * (piece.a * sin(w * s + phi) / w - v * cos(w * s + phi)) / w for A, w, phi in self._waves
        )


def _begin(piece: Piece) -> float:
    return piece.t0
