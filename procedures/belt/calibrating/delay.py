"""What it does to a belt's scale that pictures and counts may be late against each other.

A count that is late by ``tau`` puts each item back by ``tau`` times the belt's speed. At an even speed that
is the same for all looks at an item. Where the speed changes in view the items seem to step, and the step
goes into the scale. How late the counts are follows from the sightings, as far as those tell it, and from
how late devices usually are.
"""

import numpy as np

from calibration.belt.scale import BeltScale
from cell.poses import Array
from procedures.belt.calibrating.rows import SightingRows
from procedures.belt.calibrating.spread import (
    BeltUncertainty,
    beside_own_mean,
    indicators,
    noise_variance,
    widened,
)
from procedures.report.numbers import K95

# Half of the 95 % interval of a delay before any sighting tells of it. Wider than devices of this package
# leave it (cell/usual_delays.py): sightings narrow it here, so those of any make may be covered.
USUAL_95_S = 0.01
DELAY = "delay"  # in ``by``


def with_delay(sure: BeltUncertainty, answer: BeltScale, rows: SightingRows) -> BeltUncertainty:
    """``sure`` with a scale that holds whether or not the counts are as late as the sightings say."""
    used = answer.used
    item = indicators(rows.items[used])
    travel = beside_own_mean(rows.counts[used] * answer.m_per_count, item)
    speed = beside_own_mean(_speeds(rows)[used] * answer.m_per_count, item)
    slope = float(travel @ speed) / float(travel @ travel)  # of the scale, as a share, for 1 s
    if slope == 0.0:
        return sure
    left = rows.points[used] @ answer.direction - rows.counts[used] * answer.m_per_count
    left = beside_own_mean(left, item)
    seen = speed - slope * travel
    late, variance = _late(seen, left, rows.t[used], len(item.T))
    doubt = abs(late) + K95 * np.sqrt(variance)
    return widened(sure, answer, answer.m_per_count * abs(slope) * doubt, DELAY)


def _late(seen: Array, left: Array, t: Array, items: int) -> tuple[float, float]:
    """By how much counts are late (s), and its variance: from what is ``left`` of each sighting (m) beside
    what a second would make of it (``seen``, m), and from what is usual."""
    usual = (USUAL_95_S / K95) ** 2
    power = float(seen @ seen)
    rest = left - seen * (float(seen @ left) / power if power > 0.0 else 0.0)
    noise = noise_variance(rest, t, max(len(left) - items - 2, 1))
    variance = 1.0 / (1.0 / usual + (power / noise if noise > 0.0 else 0.0))
    return variance * float(seen @ left) / noise if noise > 0.0 else 0.0, variance


def _speeds(rows: SightingRows) -> Array:
    """(k,) counts a second at each sighting, from the looks at its item before and after."""
    out = np.zeros(len(rows.t))
    for number in np.unique(rows.items):
        of = np.flatnonzero(rows.items == number)
        if len(of) > 1 and np.all(np.diff(rows.t[of]) > 0.0):
            out[of] = np.gradient(rows.counts[of], rows.t[of])
    return out
