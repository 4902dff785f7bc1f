"""How long the arm takes from rest to rest with limited speed, acceleration and jerk."""

from dataclasses import dataclass

import numpy as np

from cell.poses import Array


@dataclass(frozen=True)
class MotionLimits:
    """Limits of one axis: m/s, m/s^2, m/s^3."""

    v: float
    a: float
    j: float


def rest_to_rest(distance: Array, limits: MotionLimits) -> Array:
    """Shortest time (s) over ``distance`` (m, any shape and sign); closed form, seven segments.

    Source: the time-optimal profile with jerk +j, 0, -j, 0, -j, 0, +j; segments drop out for short ways.
    """
    d = np.abs(np.asarray(distance, dtype=float))
    v, a, j = limits.v, limits.a, limits.j
    ramp = a / j if v * j >= a * a else np.sqrt(v / j)  # jerk phase of a full acceleration to v
    rise = ramp + (v / a if v * j >= a * a else ramp)
    cruising = d / v + rise
    at_a = a / j + np.sqrt((a / j) ** 2 + 4.0 * d / a)  # acceleration limit met, speed limit not
    by_jerk = 4.0 * np.cbrt(d / (2.0 * j))
    short = np.where(d <= 2.0 * a**3 / j**2, by_jerk, at_a)
    return np.asarray(np.where(d >= v * rise, cruising, short))


def slower_axis(p: Array, w: Array, limits: MotionLimits) -> Array:
    """Time (k,) from rest at ``w`` (2,) to rest at ``p`` (k, 2) of the slower of the two axes."""
    return rest_to_rest(np.abs(np.asarray(p) - np.asarray(w)[:2]).max(axis=-1), limits)
