"""The classic way of meeting an item: what results are compared with.

Speed from two successive counts, the target computed anew every 100 ms, a fixed T1 for the
way above the point whatever its length, a wait there for what the actual approach t1 leaves of it
(t4 = T1 - t1), a constant t2 for the descent. Contact is at T1 + t2 after the computation.
"""

from dataclasses import dataclass

import numpy as np

from calibration.belt.arm_time import rest_to_rest
from calibration.belt.meeting import Zone
from calibration.belt.tracking import RestingArm
from cell.poses import Array

RECOMPUTE_S = 0.1
T1_S = 0.4
_FEW = 2


@dataclass(frozen=True)
class ClassicTimes:
    """T1 and t2, s."""

    t1_s: float
    t2_s: float


@dataclass(frozen=True)
class ClassicTarget:
    """An item at ``t`` (s): ``xy`` (2,) and velocity (2,) in base, position and speed along the belt."""

    t: float
    xy: Array
    velocity: Array
    along: float
    speed: float

    def at(self, t: Array) -> Array:
        """Position (k, 2) at ``t`` (k,)."""
        return np.asarray(self.xy + (np.asarray(t) - self.t)[:, None] * self.velocity)

    def meet(
        self, arm: RestingArm, times: ClassicTimes, zone: Zone, dwell: float
    ) -> tuple[float, Array] | None:
        """Contact time and place; None when T1 is too short for the way or the place is out of the zone."""
        contact = self.t + times.t1_s + times.t2_s
        xy = self.at(np.array([contact]))[0]
        way = float(np.abs(xy - np.array(arm.wait_point)).max())
        if float(rest_to_rest(np.array(way), arm.limits)) > times.t1_s:
            return None
        along = self.along + self.speed * (np.array([contact, contact + dwell]) - self.t)
        return (contact, xy) if bool(zone.holds(along).all()) else None


def recomputed(first: float, t: float) -> float:
    """The last of the regular computations, counted from ``first``, at or before ``t``."""
    return first + RECOMPUTE_S * float(np.floor((t - first) / RECOMPUTE_S + 1e-9))


def classic_target(
    t: Array, n: Array, exposure: float, xyz: Array, direction: Array, m_per_count: float
) -> ClassicTarget | None:
    """The target from the unwrapped counts ``n`` (k,) stamped ``t`` (k,) so far; None with fewer than two.

    ``xyz`` (3,) is the item at ``exposure``; its travel since is the difference of the newest count and the
    last one before the exposure.
    """
    if len(t) < _FEW:
        return None
    then = n[max(int(np.searchsorted(t, exposure, side="right")) - 1, 0)]
    step = next((k for k in range(len(t) - 1, 0, -1) if t[k] > t[k - 1]), 0)
    speed = float((n[step] - n[step - 1]) / (t[step] - t[step - 1]) * m_per_count) if step else 0.0
    now = xyz + direction * (n[-1] - then) * m_per_count
    return ClassicTarget(float(t[-1]), now[:2], speed * direction[:2], float(now @ direction), speed)
