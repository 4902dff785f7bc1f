"""How far an arm is beside its set-points while it follows them: waves of its gears, as large as it is fast.

Measured on a UR5e at 125 Hz by ur-rtde (github.com/MingyuTang0728/Universal-Robots-Notts, 1001 rows): the
joints trail the controller's own targets by 0.44 to 0.51 ms times their speed, and by at most 0.93 mrad at
1 rad/s. The former is a delay like that of the look-ahead, which is measured with it; what is left of the
latter, 0.43 ms times the speed, is taken for the waves. That they are the two a turn of the motor that a
strain-wave gear has, behind one of 101, is an assumption.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from cell.poses import Array
from fakes.world.arm.segments import Polynomial
from fakes.world.arm.smoothed import Smoothed
from fakes.world.arm.truth import ServoTruth

WAVES = 2 * 101  # a turn of a joint
HARDEST_RAD_S2 = 50.0  # no joint is accelerated harder by a stream
_DRAWN_FOR = 0x41B1


@dataclass(frozen=True, eq=False)
class Ripple:
    """``size_s`` times a joint's speed is the largest deviation; ``phases`` (6,) rad."""

    size_s: float
    phases: Array

    @classmethod
    def of(cls, truth: ServoTruth, seed: int) -> "Ripple | None":
        """That of a scenario; None where it has none."""
        if not truth.ripple_s:
            return None
        drawn = np.random.default_rng([seed, _DRAWN_FOR]).uniform(0.0, 2.0 * np.pi, 6)
        return cls(truth.ripple_s, drawn)

    def deviation(self, q: Array, qd: Array) -> Array:
        """Of an arm that is to be at ``q`` (6,) rad and goes at ``qd`` rad/s."""
        out: Array = self.size_s * qd * np.sin(WAVES * q + self.phases)
        return out

    def beside(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """Joints and joint speeds (6,) of an arm that is to have ``q``, ``qd`` and ``qdd``."""
        angle = WAVES * q + self.phases
        wave, slope = self.size_s * np.sin(angle), self.size_s * WAVES * np.cos(angle)
        return q + qd * wave, qd * (1.0 + qd * slope) + qdd * wave

    def fastest(self, speeds: Array) -> Array:
        """A bound (6,) on the speeds of joints that are to turn at ``speeds`` at most."""
        out: Array = speeds * (1.0 + self.size_s * WAVES * speeds) + self.size_s * HARDEST_RAD_S2
        return out


@dataclass(frozen=True, eq=False)
class Rippled:
    """The arm beside a way that it follows."""

    settles: ClassVar[bool] = False
    way: Polynomial | Smoothed
    ripple: Ripple

    @property
    def t0(self) -> float:
        return self.way.t0

    @cached_property
    def t_end(self) -> float:
        return self.way.t_end

    def at(self, t: float) -> tuple[Array, Array]:
        q, qd = self.way.at(t)
        if t >= self.t_end:
            return q, qd
        return self.ripple.beside(q, qd, self.way.acceleration(t))
