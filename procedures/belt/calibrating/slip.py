"""Where the encoder's wheel slipped while items were watched.

All items of the frames after a slip are off by the same length along the belt. A slip of a millimetre is no
false sighting yet, and as a part of the scale it would be one of a tenth of a per cent.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.belt.scale import BeltScale, fit_scale
from calibration.refusal import Refusal
from procedures.belt.calibrating.rows import SightingRows
from procedures.belt.calibrating.spread import FEWEST_OF_PATTERN, indicators, noise_variance, waves

_SIGMAS = 4.5  # the largest of as many steps as there are frames
SURE = 6.0  # a slip that is told by less may be noise
_FEWEST_FRAMES = 6
_MOST = 5  # slips; with more the wheel does not follow the belt at all


@dataclass(frozen=True)
class WheelSlip:
    """At ``t`` (s) the wheel got ahead of the belt by ``ahead_m``, behind it when negative; that is
    ``sigmas`` standard deviations of what the sightings leave."""

    t: float
    ahead_m: float
    sigmas: float


@dataclass(frozen=True)
class Parted:
    """``answer`` and ``rows`` with each item parted in two where the wheel slipped, as the ``slips`` say; and
    the clearest slip that is ``left``, where parting the items once more would leave no answer.

    ``doubt`` is by how much the scale (m) differs from what it is without those slips that may be noise:
    noise that was taken for one is in the scale from then on.
    """

    answer: BeltScale
    rows: SightingRows
    slips: list[WheelSlip]
    left: WheelSlip | None
    doubt: float = 0.0


def part_at_slips(answer: BeltScale, rows: SightingRows) -> Parted:
    """Find slips, the clearest first, and part the items there."""
    slips: list[WheelSlip] = []
    doubt = 0.0
    while (slip := find_slip(answer, rows)) is not None:
        after = rows.t > slip.t
        again = replace(rows, items=np.where(after, rows.items + rows.items.max() + 1, rows.items))
        fit = fit_scale(again.points, again.counts, again.items)
        if isinstance(fit, Refusal) or len(slips) == _MOST:
            break
        if slip.sigmas < SURE:
            doubt += abs(fit.m_per_count - answer.m_per_count)
        answer, rows = fit, again
        slips.append(slip)
    return Parted(answer, rows, slips, slip, doubt)


def find_slip(answer: BeltScale, rows: SightingRows) -> WheelSlip | None:
    """The clearest step that all items make from one frame to the next; None where there is none."""
    used = answer.used
    along, travel = rows.points[used] @ answer.direction, rows.counts[used] * answer.m_per_count
    frames, column = np.unique(rows.t[used], return_inverse=True)
    if len(frames) < _FEWEST_FRAMES:
        return None
    item = indicators(rows.items[used])
    known = [item, travel[:, None]]
    if len(along) - item.shape[1] > FEWEST_OF_PATTERN:
        known.append(waves(along))  # what the camera gets wrong at one place is no step in time
    taken, _ = np.linalg.qr(np.column_stack(known))
    freedom = len(along) - taken.shape[1] - 1
    steps = (column[:, None] >= np.arange(1, len(frames))).astype(float)
    steps -= taken @ (taken.T @ steps)
    left = along - travel
    left -= taken @ (taken.T @ left)
    power = np.sum(steps**2, axis=0)
    seen = power > 0.5  # sightings' worth; no item was seen on both sides of the others
    if freedom < 2 or not seen.any():
        return None
    size = np.where(seen, (steps.T @ left) / np.where(seen, power, 1.0), 0.0)
    k = int(np.argmax(size**2 * power))
    rest = left - steps[:, k] * size[k]
    variance = noise_variance(rest, rows.t[used], freedom)
    if size[k] ** 2 * power[k] <= _SIGMAS**2 * variance:
        return None
    sigmas = float(abs(size[k]) * np.sqrt(power[k] / variance)) if variance > 0.0 else np.inf
    return WheelSlip(float(0.5 * (frames[k] + frames[k + 1])), -float(size[k]), sigmas)
