"""The tool's point along its axis: between the highest hit and the lowest miss of each beam.

The point of the reference meets a beam at the flange height ``c``, that of the current tool at
``c' = c - w.dp - bulge``; each ``c`` lies in the bracket of its passes. ``bulge`` is how much lower a tilted
flat end reaches than its middle. The heights of both beams are put together by the product of their
likelihoods, which is narrower than the mean of the two middles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cell.poses import Array

NOISE_M = 1e-6
_GRID = 121
_CONFLICT_M = 2e-5


@dataclass(frozen=True, eq=False)
class Bracket:
    """The tool's point meets the beam between ``hit`` and ``miss`` (m, flange along the lift).

    ``assumed`` says that no pass went by clear of the tool's point, and the upper end is a guess from the
    hits' steps. ``conflict`` (m) is by how much hits are above misses; ``blunders`` are the places of passes
    that were left out.
    """

    hit: float
    miss: float
    assumed: bool = False
    conflict: float = 0.0
    blunders: Sequence[int] = field(default_factory=tuple)

    @property
    def middle(self) -> float:
        return 0.5 * (self.hit + self.miss)

    @property
    def width(self) -> float:
        return abs(self.miss - self.hit)

    @property
    def sigma(self) -> float:
        """Standard deviation of where the point meets the beam."""
        return float(np.hypot(self.width / np.sqrt(12.0), max(NOISE_M, 0.5 * self.conflict)))


def bracket(hits: Mapping[int, float], misses: Mapping[int, float]) -> Bracket | None:
    """The bracket from the flange heights (m) of the passes that hit and that missed, by their places.

    Passes that contradict most of the others, a trigger that was lost or came from something else, are left
    out. None without hits; and without misses where the hits have one height alone.
    """
    if not hits:
        return None
    if not misses:
        levels = np.unique(np.round(np.array(list(hits.values())), 6))
        if len(levels) < 2:
            return None
        gap = float(levels[-1] - levels[-2])
        return Bracket(float(levels[-1]), float(levels[-1]) + gap, assumed=True, conflict=4.0 * gap)
    edges = np.unique(np.array([*hits.values(), *misses.values()]))
    between = np.concatenate([[edges[0] - 1.0], 0.5 * (edges[1:] + edges[:-1]), [edges[-1] + 1.0]])
    hit, miss = np.array(list(hits.values())), np.array(list(misses.values()))
    wrong = np.sum(hit[:, None] > between, axis=0) + np.sum(miss[:, None] < between, axis=0)
    best = between[wrong == wrong.min()]
    c = float(best[len(best) // 2])
    blunders = [k for k, h in hits.items() if h > c + _CONFLICT_M]
    blunders += [k for k, h in misses.items() if h < c - _CONFLICT_M]
    good_hits = [h for k, h in hits.items() if k not in blunders]
    good_misses = [h for k, h in misses.items() if k not in blunders]
    if not good_hits or not good_misses:
        return None
    top, bottom = max(good_hits), min(good_misses)
    return Bracket(min(top, bottom), max(top, bottom), False, max(top - bottom, 0.0), tuple(blunders))


@dataclass(frozen=True, eq=False)
class Rise:
    """One beam's say about the displacement ``z`` of the point along the axis, towards the flange:
    ``slope z + offset`` is how much lower the flange meets the beam now (m), ``offset`` being known to
    ``sigma``."""

    reference: Bracket
    current: Bracket
    slope: float
    offset: float
    sigma: float = 0.0


def along_axis(rises: Sequence[Rise]) -> tuple[float, float]:
    """Mean and standard deviation of the displacement along the axis (m), from the product of all."""
    first = [((r.reference.middle - r.current.middle - r.offset) / r.slope, _wide(r)) for r in rises]
    low = min(m - s for m, s in first)
    high = max(m + s for m, s in first)
    z = np.linspace(low, high, 4 * _GRID)
    log = np.zeros_like(z)
    for rise in rises:
        density = _difference(rise, z)
        log += np.log(np.maximum(density / np.max(density), 1e-12))
    p = np.exp(log - np.max(log))
    p /= np.sum(p)
    mean = float(p @ z)
    return mean, float(np.sqrt(p @ (z - mean) ** 2))


def _wide(rise: Rise) -> float:
    noise = rise.reference.sigma + rise.current.sigma + rise.sigma
    return (0.5 * (rise.reference.width + rise.current.width) + 4.0 * noise) / abs(rise.slope)


def _difference(rise: Rise, z: Array) -> Array:
    """(n,) likelihood of ``z``: the two brackets, each uniform with a little noise, laid over each other."""
    a, b = rise.reference, rise.current
    shift = rise.slope * z + rise.offset
    inside = np.linspace(0.0, 1.0, _GRID)
    c = a.hit + inside * (a.miss - a.hit)
    sigma = float(
        np.linalg.norm([max(NOISE_M, 0.5 * a.conflict), max(NOISE_M, 0.5 * b.conflict), rise.sigma])
    )
    u = c[None, :] - shift[:, None]
    density: Array = np.mean(np.tanh(0.8 * (u - b.hit) / sigma) - np.tanh(0.8 * (u - b.miss) / sigma), axis=1)
    return np.maximum(density, 1e-12)
