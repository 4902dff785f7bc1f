"""Whether items move as the belt's counts say: a wheel that slips on its belt is told by the camera.

With the travel taken off, an item lies still; when the wheel slips, all items in view jump the same way. One
frame that disagrees with those before may be a bad frame, so it stays doubted until the next one: two frames
that agree with each other again show that the slip is over and how far it went. Only frames that should show
the same items can disagree: where pictures are seconds apart, the belt has carried all items out of view.
"""

from dataclasses import dataclass

import numpy as np

from cell.poses import Array

_LEAST_M, _SIGMAS = 1e-3, 6.0  # no smaller jump is called one
_SCALE = 0.01  # of the way between two frames: a belt whose metres per count are nominal
_FAR_M = 0.1  # no farther jump is looked for
_SHARE = 0.5  # of the items that two frames could have in common, that must lie where they lay
_PATIENCE_S, _PICTURES = 1.0, 4  # of doubt; more of both, and the counts are not those of this belt
_NEAR_M = 0.1  # of travel between two frames, in which what one shows the other shows as well
_EDGE_M = 0.02  # of the view, where an item may be cut off


@dataclass(frozen=True)
class SightedPlaces:
    """One frame: ``places`` (k, 2) along and across the belt (m) with its travel taken off, exposed at ``t``
    (s) when the belt had made ``travel`` (m, along as the places are); ``sigma`` (m) per axis of a place."""

    t: float
    travel: float
    places: Array
    sigma: float


@dataclass(frozen=True)
class Slip:
    """From before the frame at ``t`` (s) on items lie ``by`` (m, along) from where counts have them.

    ``sigma`` of that (m), and the number of ``items`` that say so.
    """

    t: float
    by: float
    sigma: float
    items: int


@dataclass(frozen=True)
class Trust:
    """The frame is good, with those doubted ones that are not older than ``since`` (s)."""

    since: float
    slip: Slip | None = None


class SlipWatch:
    """Told of every frame with items in it, in order. ``alone`` (m): one single item that jumps farther than
    this is another item."""

    def __init__(self, alone: float) -> None:
        self._alone = alone
        self._good: SightedPlaces | None = None
        self._doubted: list[SightedPlaces] = []
        self._view = (np.inf, -np.inf)  # along the belt (m): where items were seen so far

    def look(self, frame: SightedPlaces) -> Trust | None:
        """What the frame is worth; None while that is in doubt."""
        if not len(frame.places):
            return Trust(np.inf)
        along = frame.places[:, 0] + frame.travel
        self._view = min(self._view[0], float(along.min())), max(self._view[1], float(along.max()))
        if self._good is None or self._agree(self._good, frame):
            return self._trusted(frame, np.inf)
        if self._doubted and self._agree(self._doubted[-1], frame):
            before = self._doubted[-1]
            return self._trusted(frame, before.t, self._slip(self._good, [before, frame]))
        if not any(self._common(known, frame) for known in (self._good, *self._doubted[-1:])):
            return self._trusted(frame, np.inf)  # all that was in view has left it: a beginning
        self._doubted.append(frame)
        return None

    @property
    def astray_s(self) -> float | None:
        """For how long frames have agreed neither with those before nor with each other, when that is too
        long for a slip and they are too many for bad frames: the encoder stands still, or the pictures do."""
        if len(self._doubted) < _PICTURES:
            return None
        lasts = self._doubted[-1].t - self._doubted[0].t
        return lasts if lasts > _PATIENCE_S else None

    def _trusted(self, frame: SightedPlaces, since: float, slip: Slip | None = None) -> Trust:
        self._good = frame
        self._doubted.clear()
        return Trust(since, slip)

    def _slip(self, good: SightedPlaces, settled: list[SightedPlaces]) -> Slip | None:
        """The least jump that most items made; None when nothing is recognised."""
        jumps = [_jumps(good, frame) for frame in settled]
        around = _tolerance(good, settled[-1])
        found = _clusters(jumps[-1], around)
        if not found or not self._common(good, settled[-1]):
            return None
        most = max(len(cluster) for cluster in found)
        likely = [cluster for cluster in found if len(cluster) >= _SHARE * most]
        middle = float(np.median(min(likely, key=lambda cluster: abs(float(np.median(cluster))))))
        near = [rows[np.abs(rows - middle) <= around] for rows in jumps]
        items = len(near[-1])
        alone = items == 1
        if alone and (self._common(good, settled[-1]) > 1 or abs(middle) > self._alone):
            return None
        every = np.concatenate(near)
        sigma = good.sigma * float(np.sqrt((1.0 + 1.0 / len(settled)) / items))
        return Slip(settled[0].t, float(np.mean(every)), sigma, items)

    def _agree(self, a: SightedPlaces, b: SightedPlaces) -> bool:
        """Whether enough of the items lie where they lay."""
        stay = int(np.sum(np.abs(_jumps(a, b)) <= _tolerance(a, b)))
        return stay > 0 and stay >= _SHARE * self._common(a, b)

    def _common(self, a: SightedPlaces, b: SightedPlaces) -> int:
        """How many items both should show, by the counts."""
        return min(self._shown(a, b), self._shown(b, a))

    def _shown(self, a: SightedPlaces, b: SightedPlaces) -> int:
        """How many items of ``a`` were still or already in view when ``b`` was taken."""
        if abs(b.travel - a.travel) <= _NEAR_M:
            return len(a.places)
        along = a.places[:, 0] + b.travel
        return int(np.sum((along > self._view[0] + _EDGE_M) & (along < self._view[1] - _EDGE_M)))


def _tolerance(a: SightedPlaces, b: SightedPlaces) -> float:
    return max(_LEAST_M, _SIGMAS * float(np.hypot(a.sigma, b.sigma))) + _SCALE * abs(b.travel - a.travel)


def _jumps(a: SightedPlaces, b: SightedPlaces) -> Array:
    """Differences along (n,), from any place in ``a`` to any in ``b`` that lies as far across, ascending."""
    off = b.places[None] - a.places[:, None]
    level = (np.abs(off[..., 1]) <= _tolerance(a, b)) & (np.abs(off[..., 0]) <= _FAR_M)
    return np.asarray(np.sort(off[..., 0][level]))


def _clusters(jumps: Array, around: float) -> list[Array]:
    """Groups of jumps that are within ``around`` of each other, one beginning at each jump."""
    ends = np.searchsorted(jumps, jumps + around, side="right")
    return [jumps[k:end] for k, end in enumerate(ends)]
