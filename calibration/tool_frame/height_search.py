"""Where to cross next, to know the height at which the tool's end meets a beam: where most is to be learned.

Between the lowest way that passed by and the first that met the tool, every height is as likely as another.
From then on each pass narrows that down, by being a hit or a miss and by how long the beam was broken. The
next pass goes where the variance of the height is expected to be least after it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from calibration.tool_frame.glimpse import Glimpse
from calibration.tool_frame.height import NEAR_M, first_contact, weights
from calibration.tool_frame.repeatability import Scatter
from calibration.tool_frame.tip import POINT, UPRIGHT, ToolInBeam
from cell.poses import Array

POLLS_OF_A_BREAK = 4.0  # at least, at the speed that is chosen
_CANDIDATES = 33
_CLASSES = 20  # of lengths that are told apart
_COARSE = 4  # points of the grid that are looked at as one
_DEEPEST_M = 4e-4  # below the likely heights: the lengths of breaks tell less further down
_RARE = 0.02


@dataclass(frozen=True)
class Next:
    """The flange ``height`` (m) of the next pass, the ``speed`` (m/s), and the longest break there (m)."""

    height: float
    speed: float
    longest: float


@dataclass(frozen=True)
class Sought:
    """What is known of a height after some passes: its ``mean`` and standard deviation ``sigma`` (m, flange
    upwards), and where the next pass tells most."""

    mean: float
    sigma: float
    next: Next


@dataclass(frozen=True, eq=False)
class HeightSearch:
    """What is known of one height before the first pass near it, in flange metres upwards.

    The tool's end is met between ``hit`` and ``clear`` (m). ``chord`` (m) is how long the tool breaks the
    beam well above its end, ``fingers`` that several of its parts break it. ``fast`` and ``slow`` (m/s) are
    the speeds there are, ``period_s`` the time between two polls.
    """

    hit: float
    clear: float
    chord: float
    fingers: bool
    scatter: Scatter
    fast: float
    slow: float
    period_s: float


def sought(search: HeightSearch, glimpses: Sequence[Glimpse]) -> Sought:
    """What all passes so far say. Some 30 ms of computing: not for the loop."""
    found = _Seeking(search, glimpses)
    return Sought(found.mean, found.sigma, found.next())


class _Seeking:
    def __init__(self, search: HeightSearch, glimpses: Sequence[Glimpse]) -> None:
        self.search, self.chord = search, search.chord
        up, along = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
        side = np.cross(up, along)
        self.view = ToolInBeam(-up, side, up, side, 0.5 * self.chord, self.chord)
        ends = POINT if search.fingers else UPRIGHT
        found = first_contact(glimpses, self.view, ends, search.scatter, search.hit, search.clear)
        w = weights(found.evidence, ends, search.scatter)
        self.mean = float(np.sum(w * found.mean))
        self.sigma = float(np.sqrt(np.sum(w * (found.var + (found.mean - self.mean) ** 2))))
        step = float(found.grid[1] - found.grid[0])
        p = np.exp(found.log - found.evidence[..., None]) * step * w[..., None]
        by_end = np.sum(p, axis=1)
        n = len(found.grid) // _COARSE * _COARSE
        self._grid = found.grid[:n].reshape(-1, _COARSE).mean(axis=1)
        likely = np.sum(by_end, axis=1) > _RARE * np.max(np.sum(by_end, axis=1))
        self._ends = [end for end, use in zip(ends, likely, strict=True) if use]
        self._p = by_end[likely, :n].reshape(len(self._ends), -1, _COARSE).sum(axis=2)
        self._p /= np.sum(self._p)

    def next(self) -> Next:
        """Where the next pass out and back tells most."""
        total = np.sum(self._p, axis=0)
        n, step = len(self._grid), float(self._grid[1] - self._grid[0])
        below, above = np.interp([0.02, 0.98], np.cumsum(total) / np.sum(total), self._grid)
        scatter = self.search.scatter.usual
        low = min(max(below - _DEEPEST_M, self.search.hit), above)
        # Candidates are points of the grid, and others below it, so that depths are whole steps.
        first, last = ((h - self._grid[0]) / step for h in (low, above + scatter))
        places = np.unique(np.round(np.linspace(first, last, _CANDIDATES)).astype(int))
        depths = step * np.arange(-max(int(places[-1]), 0), n - min(int(places[0]), 0))
        tables: dict[float, Array] = {}
        best, height = np.inf, self.mean
        for k in places:
            at = float(self._grid[0] + k * step)
            speed = self._speed(at, scatter)
            if speed not in tables:
                tables[speed] = self._table(np.asarray(depths, dtype=float), speed, scatter)
            begin = max(int(places[-1]), 0) - int(k)
            variance = self._expected(tables[speed][:, :, begin : begin + n])
            if variance < best:
                best, height = variance, at
        deep = max(above - low, 0.0) + 3.0 * scatter  # wherever the way back goes
        longest = float(np.max(self.view.lengths(self._ends, np.array([deep]))))
        return Next(height, self._speed(height, scatter), longest)

    def _speed(self, height: float, scatter: float) -> float:
        """Fast where the break that is expected lasts long enough all the same."""
        depth = np.array([max(self.mean - height, self.sigma, scatter)])
        usual = float(np.min(self.view.lengths(self._ends, depth)))
        fast = self.search.fast
        return fast if usual >= POLLS_OF_A_BREAK * fast * self.search.period_s else self.search.slow

    def _table(self, depths: Array, speed: float, scatter: float) -> Array:
        """(ends, classes, n) how likely each class of lengths is to be seen at ``depths`` (n,) m."""
        resolution = 0.7 * speed * self.search.period_s
        half = _CLASSES // 2
        longer = np.geomspace(resolution * half, max(self.chord, 2.0 * resolution * half), half)
        cuts = np.concatenate([resolution * np.arange(1, half), longer])
        found = np.zeros((len(self._ends), len(cuts) + 2, len(depths)))
        for off, share in zip((-1.2, 0.0, 1.2), (0.25, 0.5, 0.25), strict=True):
            lengths = self.view.lengths(self._ends, depths + off * scatter)
            found += share * np.stack([_classes(each, depths > NEAR_M, cuts, resolution) for each in lengths])
        return found

    def _expected(self, table: Array) -> float:
        """Variance (m^2) that is left, on average, after a pass of ``table`` (ends, classes, n)."""
        chance = np.einsum("ecn,en->cn", table, self._p)
        weight = np.maximum(np.sum(chance, axis=1), 1e-300)
        off = self._grid - self.mean
        mean, second = chance @ off / weight, chance @ off**2 / weight
        return float(weight @ np.maximum(second - mean**2, 0.0))


def _classes(length: Array, deep: NDArray[np.bool_], cuts: Array, resolution: float) -> Array:
    """(classes, n) how likely a break of ``length`` (n,) m is seen between which of ``cuts`` (m); the first
    class is a miss, the last one of breaks so ``deep`` (n,) that their length says nothing."""
    missed = np.clip(1.0 - length / resolution, 0.0, 1.0)
    below = ndtr((cuts[:, None] - length) / (0.4 * resolution))
    ends = np.concatenate([np.zeros((1, len(length))), below, np.ones((1, len(length)))])
    seen = np.diff(ends, axis=0) * np.where(deep, 0.0, 1.0 - missed)
    found = np.concatenate([missed[None], seen])
    found[-1] += np.where(deep, 1.0 - missed, 0.0)
    return found
