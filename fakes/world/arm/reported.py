"""What a controller reports beside what is so: noise of joints and speeds, and a force that wanders.

All of it is a function of time and of the seed, so that two looks at one cycle agree.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from cell.poses import Array
from fakes.world.arm.truth import ReportedTruth

_DRAWN_FOR = 0x5E2F
_CYCLE_S, _CYCLES = 0.002, 4099
_WALKS, _PERIODS_S = 4, (10.0, 40.0)


class Reported:
    """Noise to add to what is reported at ``t``."""

    def __init__(self, truth: ReportedTruth, seed: int) -> None:
        self._truth, self._seed = truth, seed
        self._newest: tuple[float, Array] | None = None

    @property
    def late_s(self) -> float:
        """Joints, speeds and the TCP's pose are those of so much before their stamp."""
        return self._truth.stamp_late_s

    @property
    def exact(self) -> bool:
        """Whether joints and speeds are reported as they are."""
        return not (self._truth.q_noise_rad or self._truth.qd_noise_rad_s)

    def joints(self, t: float, q: Array, qd: Array) -> tuple[Array, Array]:
        """Joints and speeds (6,) as they are told."""
        if self.exact:
            return q, qd
        draw = self._draws[int(t / _CYCLE_S) % _CYCLES]
        return q + self._truth.q_noise_rad * draw[:6], qd + self._truth.qd_noise_rad_s * draw[6:]

    def joints_at(self, times: Sequence[float], q: Array, qd: Array) -> tuple[Array, Array]:
        """The same of many times (n,): joints and speeds (n, 6)."""
        if self.exact:
            return q, qd
        draws = self._draws[[int(t / _CYCLE_S) % _CYCLES for t in times]]
        return q + self._truth.q_noise_rad * draws[:, :6], qd + self._truth.qd_noise_rad_s * draws[:, 6:]

    def force(self, t: float) -> Array:
        """Force and moment (6,) that the sensor shows without a contact, read only."""
        newest = self._newest
        if newest is None or newest[0] != t:  # a controller on the wire tells each in two ways
            newest = self._newest = t, self.forces((t,))[0]
            newest[1].flags.writeable = False
        return newest[1]

    def forces(self, times: Sequence[float]) -> Array:
        """The same of many times (n,): (n, 6), in little more time than of one."""
        forces = np.zeros((len(times), 6))
        if self._truth.force_bias_n or self._truth.force_walk_n:
            bias, walk, phase, pace = self._walk
            waves = np.sin(phase + pace * np.array(times)[:, None])
            # Wave by wave: a product of matrices may round one row of many otherwise than one by itself.
            forces[:, :3] = bias + (waves[:, :, None] * walk).sum(axis=1)
        return forces

    @cached_property
    def _draws(self) -> Array:
        return np.random.default_rng([self._seed, _DRAWN_FOR]).standard_normal((_CYCLES, 12))

    @cached_property
    def _walk(self) -> tuple[Array, Array, Array, Array]:
        """The bias (3,) N, and of slow waves the amplitudes (k, 3) N, phases and paces (k,)."""
        rng = np.random.default_rng([self._seed, _DRAWN_FOR, 1])
        way = rng.standard_normal((1 + _WALKS, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        pace = 2.0 * np.pi / rng.uniform(*_PERIODS_S, _WALKS)
        phase = rng.uniform(0.0, 2.0 * np.pi, _WALKS)
        return self._truth.force_bias_n * way[0], self._truth.force_walk_n * way[1:], phase, pace
