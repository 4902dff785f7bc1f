"""Sightings of a moving belt told apart: which of them are of one item, and at which count each was seen.

Only what is in the data set is used, so that replay comes to the same rows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist, pdist

from calibration.belt.clock import FrameCounter, true_times
from cell.poses import Array, from_pose6

_RHYTHM_S = 1.0  # either side of an exposure, where the encoder's rhythm is looked for
_SMOOTH_S = 0.06  # either side of it, where the belt's motion is a parabola
_FEWEST_NEAR = 7
_WAVES = np.arange(1, 13)  # of the saw tooth that rounding is
_GAP_S = 0.1  # between two counts; over more, the count at an exposure is unknown
_ALONE_M = 0.1  # how far an item may have moved from frame to frame when it is always alone
_SHARE = 0.4  # of the least distance of two items in one frame
STEP_COUNTS = 4.0  # from look to look: where the belt stands, many looks would share one rounding
_MISSED_FRAMES = 3  # an item unseen for longer is a new one


@dataclass(frozen=True)
class SightingRows:
    """``points`` (k, 3) m in the base at the unwrapped ``counts`` (k,), of ``items`` (k,), seen at ``t``.

    ``rounding`` (k, waves), complex: what of the counts' rounding is left in each (:class:`Counted`).
    """

    t: Array
    points: Array
    counts: Array
    items: NDArray[np.int64]
    rounding: NDArray[np.complex128] | None = None


@dataclass(frozen=True)
class Counted:
    """The ``count`` at a time, and what is left in it of the ``rounding`` (waves,) of the counts about it.

    Rounding is a saw tooth over the count: waves of the amplitudes 1 / (pi h), h = 1, 2, ... At an even speed
    it goes the same way in every look, or drifts with the belt, so it does not get less with more looks. Each
    complex number is a wave's amplitude and phase at that time, as a share of the saw tooth's own.
    """

    count: float
    rounding: NDArray[np.complex128]


@dataclass
class _Chain:
    number: int
    frame: int
    point: Array
    count: float
    first: tuple[Array, float]

    def slope(self) -> Array | None:
        n = self.count - self.first[1]
        return (self.point - self.first[0]) / n if n else None


class ItemFollower:
    """Follows each item from frame to frame, to where the counts say that it has moved since.

    ``guess`` (3,) is the configured motion of one count, m. Without it the first step is looked for near by.
    """

    def __init__(self, guess: Array | None, step_counts: float = STEP_COUNTS) -> None:
        self._step_counts, self._count = step_counts, -np.inf
        self._usual: Array = np.zeros(3) if guess is None else guess
        self._apart = np.inf
        self._open: list[_Chain] = []
        self._found: list[tuple[float, Array, float, int]] = []
        self._frames = self._made = 0
        self._way = 0.0  # of the belt, counts, of what was counted before the encoder began anew
        self._begun: float | None = None  # the first count since then

    def begin(self) -> None:
        """The encoder counts anew: what was counted before says nothing of where an item is now."""
        self._way, self._begun = self._counted(), None
        self._open, self._count = [], -np.inf

    def _counted(self) -> float:
        return self._way + (0.0 if self._begun is None else abs(self._count - self._begun))

    def add(
        self, t: float, count: float, points: Array, each: Sequence[tuple[float, float]] | None = None
    ) -> None:
        """One more frame with the items at ``points`` (k, 3) m in the base, exposed at ``t``.

        Left out when the belt has hardly moved since the one before. ``each`` has time and count of every
        point, where a rolling shutter sees them one after the other.
        """
        if abs(count - self._count) < self._step_counts:
            return
        self._count = count
        if len(points) and self._begun is None:
            self._begun = count
        self._frames += 1
        if len(points) > 1:
            self._apart = min(self._apart, float(pdist(points).min()))
        self._open = [c for c in self._open if self._frames - c.frame <= _MISSED_FRAMES]
        own = each or [(t, count)] * len(points)
        for point, chain, (at, count) in zip(points, self._matched(own, points), own, strict=True):
            if chain is None:
                chain = _Chain(self._made, self._frames, point, count, (point, count))
                self._open.append(chain)
                self._made += 1
            chain.frame, chain.point, chain.count = self._frames, point, count
            self._found.append((at, point, count, chain.number))
        # The common motion, not each item's own: all lie on one belt, and a false sighting is outvoted.
        if known := [s for c in self._open if (s := c.slope()) is not None]:
            self._usual = np.median(known, axis=0)

    def _matched(self, own: Sequence[tuple[float, float]], points: Array) -> list[_Chain | None]:
        chains: list[_Chain | None] = [None] * len(points)
        if not self._open or not len(points):
            return chains
        gate = min(_SHARE * self._apart, _ALONE_M)
        counts = np.array([count for _, count in own])
        places = np.array([c.point - c.count * self._usual for c in self._open])  # at count 0
        away = cdist(places, points - counts[:, None] * self._usual)
        for i, j in zip(*linear_sum_assignment(np.minimum(away, 2.0 * gate)), strict=True):
            if away[i, j] <= gate:
                chains[j] = self._open[i]
        return chains

    def __len__(self) -> int:
        return len(self._found)

    @property
    def way_m(self) -> float:
        """How far the belt has moved between the first sighting and the last, as the items show it."""
        return float(np.linalg.norm(self._usual)) * self._counted()

    def rows(self) -> SightingRows:
        """Every sighting with its item."""
        return SightingRows(
            np.array([row[0] for row in self._found]),
            np.array([row[1] for row in self._found]).reshape(-1, 3),
            np.array([row[2] for row in self._found]),
            np.array([row[3] for row in self._found], dtype=np.int64),
        )


def rows_of(data: Mapping[str, Any], step_counts: float = STEP_COUNTS) -> SightingRows:
    """The sightings of a data set, or its touches, which are all of one mark."""
    if data["source"] == "touch":
        touches = data["touches"]
        points = np.array([touch["point"] for touch in touches]).reshape(-1, 3)
        counts = np.array([touch["count"] for touch in touches], dtype=float)
        t = np.array([touch["t"] for touch in touches], dtype=float)
        return SightingRows(t, points, counts, np.zeros(len(t), dtype=np.int64))
    T = from_pose6(data["T_base_camera"])
    encoder = np.array(data["encoder"], dtype=float).reshape(-1, 2)
    follower = ItemFollower(motion_of(data.get("configured")), step_counts)
    times = [float(seen["t"]) for seen in data["sightings"]]
    epoch = 0
    parts = parts_of(encoder, data)
    starts = np.array([part[0, 0] for part in parts[1:]])
    in_part = np.searchsorted(starts, times, side="right")
    wanted = [
        [t, *(t + late for late in seen.get("after_s", ()))]
        for t, seen in zip(times, data["sightings"], strict=True)
    ]
    found = dict[float, Counted | None]()
    for k, part in enumerate(parts):
        these = [t for each, i in zip(wanted, in_part, strict=True) if i == k for t in each]
        found |= zip(these, counts_at(part, these, data["period_s"]), strict=True)
    for seen, own, part_of in zip(data["sightings"], wanted, in_part, strict=True):
        if part_of != epoch:
            follower.begin()
            epoch = part_of
        known = [(t, counted.count) for t in own if (counted := found[t]) is not None]
        if len(known) == len(own):
            (at, count), *each = known
            follower.add(at, count, T.apply(np.array(seen["points"])), each or None)
    rows = follower.rows()
    left = {t: counted.rounding for t, counted in found.items() if counted is not None}
    return replace(rows, rounding=np.array([left[t] for t in rows.t]).reshape(-1, len(_WAVES)))


def parts_of(encoder: Array, data: Mapping[str, Any]) -> list[Array]:
    """The counts (k, 2: s, counts) parted where the encoder began to count anew, at ``begins`` (s)."""
    cuts = np.searchsorted(encoder[:, 0], [float(t) for t in data.get("begins", ())])
    return [part for k, part in enumerate(np.split(encoder, cuts)) if k == 0 or len(part)]


def counts_at(encoder: Array, times: Sequence[float], period_s: float) -> list[Counted | None]:
    """The count at each of ``times`` (s), from ``encoder`` (k, 2: s, counts).

    The jitter of stamps and the rounding of counts are smoothed out. None where there are no counts close by
    on both sides.
    """
    frames = FrameCounter(period_s)
    slots = np.array([frames.add(float(t), float(n)) for t, n in encoder], dtype=np.int64)
    return [_smoothed(encoder, slots, t) for t in times]


def _smoothed(encoder: Array, slots: NDArray[np.int64], t: float) -> Counted | None:
    if (plain := count_at(encoder, t)) is None:
        return None
    begin, end = np.searchsorted(encoder[:, 0], [t - _RHYTHM_S, t + _RHYTHM_S])
    wide = slice(int(begin), int(end))
    n = encoder[wide, 1] - plain
    true = true_times(encoder[wide, 0], slots[wide], n).t - t
    near, order = np.abs(true) <= _SMOOTH_S, 2
    if near.sum() < _FEWEST_NEAR or not true[near].min() < 0.0 < true[near].max():
        i = int(np.searchsorted(encoder[wide, 0], t))
        true, near, order = encoder[wide, 0] - t, np.isin(np.arange(len(n)), (i - 1, i)), 1
    basis = np.vander(true[near] / _SMOOTH_S, order + 1, increasing=True)
    fit = np.linalg.pinv(basis)
    motion = basis @ (fit @ n[near])  # less rounded than the counts themselves
    rounding = fit[0] @ np.exp(2j * np.pi * np.outer(plain + motion, _WAVES))
    return Counted(plain + float(fit[0] @ n[near]), rounding)


def rounding_variance(weight: Array, rounding: NDArray[np.complex128]) -> float:
    """Variance (counts^2) that rounding leaves in a sum of counts with the ``weight`` (k,) of each."""
    return float(np.sum(np.abs(weight @ rounding) ** 2 / (2.0 * np.pi**2 * _WAVES**2)))


def motion_of(belt: Mapping[str, Any] | None) -> Array | None:
    """What one count moves a configured belt by (3,), m."""
    return None if belt is None else np.array(belt["dir"], dtype=float) * float(belt["m_per_count"])


def count_at(encoder: Array, t: float) -> float | None:
    """The count at ``t`` among ``encoder`` (k, 2: s, counts); None without one close by on both sides."""
    i = int(np.searchsorted(encoder[:, 0], t))
    if not 0 < i < len(encoder) or encoder[i, 0] - encoder[i - 1, 0] > _GAP_S:
        return None
    return float(np.interp(t, encoder[i - 1 : i + 1, 0], encoder[i - 1 : i + 1, 1]))
