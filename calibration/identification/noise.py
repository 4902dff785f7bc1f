"""How far a reading lies from the truth: ``sigma0 + sigma_per_m * range``, along every axis alike."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from cell.poses import Array

TYPICAL = {"sigma0": 15e-6, "sigma_per_m": 6e-6}  # what trackers of today promise
FLOOR = 1e-6  # m; no tracker is better, and the weights must not swamp the prior's place in the sums
_SHAPES = np.concatenate([[0.0], np.geomspace(0.03, 30.0, 25)])  # sigma_per_m over sigma0, 1/m
_NARROW = 1.2  # ranges that differ less say nothing about sigma_per_m
_CHANCE = 1e-3
_SAME = 0.5


@dataclass(frozen=True)
class TrackerNoise:
    """``sigma0`` (m) and ``sigma_per_m`` (m/m); ``given`` or estimated from the residuals."""

    sigma0: float
    sigma_per_m: float
    given: bool

    def sigma(self, range_m: Array) -> Array:
        """(n,) m, never below what any tracker resolves."""
        return np.maximum(self.sigma0 + self.sigma_per_m * range_m, FLOOR)

    def close_to(self, other: "TrackerNoise") -> bool:
        """Whether another estimate is about as large at a few metres, so that weights need not change."""
        here, there = (noise.sigma0 + 3.0 * noise.sigma_per_m for noise in (self, other))
        return abs(here - there) <= _SAME * max(here, there)


def first_noise(given: Mapping[str, float]) -> TrackerNoise:
    """Given levels, or what trackers promise; a ``sigma0`` that is given alone is the same at all ranges."""
    if "sigma0" in given:
        return TrackerNoise(given["sigma0"], given.get("sigma_per_m", 0.0), True)
    return TrackerNoise(TYPICAL["sigma0"], TYPICAL["sigma_per_m"], False)


def estimated(noise: TrackerNoise, e: Array, range_m: Array, unknowns: float) -> TrackerNoise:
    """The levels under which residuals ``e`` (3, n) of a fit with so many ``unknowns`` are most likely.

    Given levels stay as they are. The unknowns have taken up their share of the squares, so the sum is
    divided by the degrees of freedom that are left.
    """
    left = e.size - unknowns
    if noise.given or left <= 0:
        return noise
    squared = np.sum(e**2, axis=0)
    shapes = _SHAPES if range_m.max() > _NARROW * range_m.min() else _SHAPES[:1]
    relative = 1.0 + shapes[:, None] * range_m
    mean = (1.0 / relative**2) @ squared / left
    cost = left * np.log(np.maximum(mean, 1e-300)) + 6.0 * left / e.size * np.sum(np.log(relative), axis=1)
    k = int(np.argmin(cost))
    sigma0 = max(float(np.sqrt(mean[k])), 1e-9)
    return TrackerNoise(sigma0, float(shapes[k]) * sigma0, False)


def excess(e: Array, sigma: Array, unknowns: float) -> float:
    """The factor by which the squares exceed what ``sigma`` (n,) explains; 1 within chance."""
    left = e.size - unknowns
    if left <= 0:
        return 1.0
    squared = float(np.sum((e / sigma) ** 2))
    return squared / left if squared > chdtri(left, _CHANCE) else 1.0
