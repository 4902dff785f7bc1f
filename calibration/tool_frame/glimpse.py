"""What one pass near the tool's end says of how long the beam was broken.

The polls of a pass have places along the way. A break of length L whose middle is somewhere about where the
tool is known to cross is seen by some of them, or falls between two: how likely that is for every L follows
from those polls and no others. A pass whose polls could not have seen a break tells nothing by missing it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from cell.poses import Array

LOST = 1e-3  # how often a pass is not what it seems: a trigger that was lost, or came from something else
_POINTS = 121
_FAR = 5.0  # standard deviations of the middle


@dataclass(frozen=True, eq=False)
class Glimpse:
    """One pass at the flange's ``height`` (m, along the lift). ``chance`` (n,) is how likely its polls are
    with a break as long as ``lengths`` (n,) m, up to a factor; ``beyond`` with a longer one. ``pair`` numbers
    the passes that were taken one after the other between the same standstills. ``hit``: it was seen.
    ``sense`` is 1 on a way along the view's ``side`` and -1 on one against it."""

    height: float
    pair: int
    hit: bool
    lengths: Array
    chance: Array
    beyond: float = 0.0
    sense: float = 1.0

    def at(self, length: Array) -> Array:
        """How likely the polls are with a break of ``length`` (...) m, 0 being none; at most 1."""
        seen = np.interp(length, self.lengths, self.chance, left=0.0 if self.hit else 1.0, right=self.beyond)
        found: Array = LOST + (1.0 - LOST) * seen
        return found

    @property
    def likely_length(self) -> float:
        """Mean length of the breaks that the polls of a hit allow, m."""
        return float(np.sum(self.chance * self.lengths) / max(np.sum(self.chance), 1e-300))

    @cached_property
    def _seen_m(self) -> float:
        """``chance`` summed over ``lengths``, m."""
        return float(np.trapezoid(self.chance, self.lengths))

    def of_any(self, longest: float) -> float:
        """How likely the polls are with a break of any length up to ``longest`` (m)."""
        wide = self._seen_m + self.beyond * longest
        return float(np.clip(wide / longest, LOST, 1.0))


def glimpse(
    height: float,
    pair: int,
    places: Array,
    dark: NDArray[np.bool_],
    centre: float,
    sigma: float,
    soft: float = 0.0,
    pulse: tuple[float, float] | None = None,
    sense: float = 1.0,
    unsure: float = 0.0,
) -> Glimpse:
    """A pass with polls at ``places`` (m,) m along the way, growing, ``dark`` (m,) where they saw the beam
    broken. The middle of a break is expected at ``centre`` (m), known to ``sigma``; ``soft`` (m) is how far
    the places may be off. ``pulse``: a counter saw a break between these two places, and no poll did.
    ``unsure`` (m) is how far off the tool's chord may be, with which the break of a hit is compared."""
    seen = np.flatnonzero(dark)
    if len(seen):
        first, last = int(seen[0]), int(seen[-1])
        a1, b1 = float(places[max(first - 1, 0)]), float(places[first])
        a2, b2 = float(places[last]), float(places[min(last + 1, len(places) - 1)])
    elif pulse is not None:
        (a1, b1), (a2, b2) = pulse, pulse
    else:
        return _missed(height, pair, places, centre, sigma, soft, sense)
    soft += 0.5 * unsure
    a1, b1, a2, b2 = a1 - soft, b1 + soft, a2 - soft, b2 + soft
    lengths = np.linspace(max(a2 - b1, 0.0), b2 - a1, _POINTS)
    # The middle lies where both ends of the break are in their intervals.
    low = np.maximum(a1 + 0.5 * lengths, a2 - 0.5 * lengths)
    high = np.minimum(b1 + 0.5 * lengths, b2 - 0.5 * lengths)
    middle = 0.25 * (a1 + b1 + a2 + b2)
    wide = max(sigma, abs(middle - centre) / 2.0)  # a hit shows where it was
    chance = np.maximum(ndtr((high - centre) / wide) - ndtr((low - centre) / wide), 0.0)
    top = float(np.max(chance))
    return Glimpse(height, pair, True, lengths, chance / top if top > 0.0 else chance + 1.0, 0.0, sense)


def plain_hit(height: float, pair: int) -> Glimpse:
    """A pass that met some part of the tool; how long the break was says nothing."""
    return Glimpse(height, pair, True, np.array([0.0, 1e-9]), np.array([0.0, 1.0]), 1.0)


def _missed(
    height: float, pair: int, places: Array, centre: float, sigma: float, soft: float, sense: float
) -> Glimpse:
    near = np.flatnonzero(np.abs(places - centre) < _FAR * sigma)
    if len(near):
        first, last = max(int(near[0]) - 1, 0), min(int(near[-1]) + 2, len(places))
    else:
        first = max(int(np.searchsorted(places, centre)) - 1, 0)
        last = min(first + 2, len(places))
    # Before the first poll and after the last nothing is seen.
    ends: Sequence[Array] = (np.array([-np.inf]), places[first:last], np.array([np.inf]))
    edges = np.concatenate(ends)
    gaps = np.diff(edges)
    widest = float(np.max(gaps[np.isfinite(gaps)], initial=0.0)) + 2.0 * soft
    lengths = np.linspace(0.0, widest, _POINTS)
    half = 0.5 * lengths[:, None] - soft
    inside = ndtr((edges[1:] - half - centre) / sigma) - ndtr((edges[:-1] + half - centre) / sigma)
    chance: Array = np.minimum(np.sum(np.maximum(inside, 0.0), axis=1), 1.0)
    return Glimpse(height, pair, False, lengths, chance, 0.0, sense)
