"""Where to cross next, to know the height at which the tool's end meets a beam: where most is to be learned.

Between the lowest way that passed by and the first that met the tool, every height is as likely as another.
From then on each pass narrows that down, by being a hit or a miss and by how long the beam was broken. The
next pass goes where the variance of the height is expected to be least after it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration.tool_frame.glimpse import Glimpse
from calibration.tool_frame.height import (
    ABOVE_M,
    NEAR_M,
    Density,
    likely,
    log_likelihood,
    weights,
)
from calibration.tool_frame.repeatability import PassScatter
from calibration.tool_frame.tip import POINT, UPRIGHT, TipShape, ToolInBeam
from cell.poses import Array

POLLS_OF_A_BREAK = 4.0  # at least, at the speed that is chosen
SLOWER = (1.0, 0.5, 0.25)  # of the slow speed, where even that is too fast for so many polls
_CANDIDATES = 33
_CLASSES = 20  # of lengths that are told apart
_CELLS = 80  # of the likely heights
_POINTS = 601  # of a grid at most
_FINE_M = 3e-6  # between two of them where as many do
_NARROWER = 0.5  # of the grid: then a finer one is worth its computing
_SPREAD = 1.4  # of a length that is seen, in those that are told apart
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
    upwards), and where the next pass tells most. ``belief`` is what to go on from."""

    mean: float
    sigma: float
    next: Next
    belief: "Belief"


@dataclass(frozen=True, eq=False)
class HeightSearch:
    """What is known of one height before the first pass near it, in flange metres upwards.

    The tool's end is met between ``hit`` and ``clear`` (m). ``chord`` (m) is how long the tool breaks the
    beam well above its end, ``fingers`` that several of its parts break it. ``fast`` and ``slow`` (m/s) are
    the usual speeds, ``period_s`` the time between two polls.
    """

    hit: float
    clear: float
    chord: float
    fingers: bool
    scatter: PassScatter
    fast: float
    slow: float
    period_s: float


@dataclass(frozen=True, eq=False)
class Belief:
    """What ``glimpses`` say of the height: ``log`` (E, S, n) of how likely they are at ``grid`` (n,) m."""

    glimpses: tuple[Glimpse, ...]
    grid: Array
    log: Array


def sought(search: HeightSearch, glimpses: Sequence[Glimpse], before: Belief | None = None) -> Sought:
    """What all passes so far say: those of ``before``, and ``glimpses`` that came since. Some milliseconds of
    computing: not for the loop."""
    found = _Seeking(search, glimpses, before)
    return Sought(found.mean, found.sigma, found.next(), found.belief)


class _Seeking:
    def __init__(self, search: HeightSearch, glimpses: Sequence[Glimpse], before: Belief | None) -> None:
        self.search, self.chord = search, search.chord
        self.view = upright(self.chord)
        self._ends: Sequence[TipShape] = POINT if search.fingers else UPRIGHT
        self._scatter = search.scatter.coarser
        self.belief = self._narrowed(self._with(glimpses, before or self._nothing()))
        self._weigh()

    def _nothing(self) -> Belief:
        low, high = self.search.hit - ABOVE_M, self.search.clear + ABOVE_M
        grid = np.linspace(low, high, _points(low, high))
        return Belief((), grid, np.zeros((len(self._ends), len(self._scatter.sigmas), len(grid))))

    def _with(self, glimpses: Sequence[Glimpse], known: Belief) -> Belief:
        """Each way has a height of its own, and tells by itself."""
        if not glimpses:
            return known
        told = log_likelihood(glimpses, self.view, self._ends, self._scatter, known.grid)
        return Belief((*known.glimpses, *glimpses), known.grid, known.log + told)

    def _narrowed(self, known: Belief) -> Belief:
        """On a finer grid once most of it is out of question."""
        a, b = likely(known.log)
        first, last = float(known.grid[0]), float(known.grid[-1])
        low, high = max(float(known.grid[a]) - ABOVE_M, first), min(float(known.grid[b]) + ABOVE_M, last)
        if known.grid[1] - first <= _FINE_M or high - low > _NARROWER * (last - first):
            return known
        grid = np.linspace(low, high, _points(low, high))
        nothing = Belief((), grid, np.zeros((*known.log.shape[:2], len(grid))))
        return self._with(known.glimpses, nothing)

    def _weigh(self) -> None:
        """Mean, deviation, and the density by ends in cells that are wide enough to choose with."""
        a, b = likely(self.belief.log)
        near = slice(max(a - 1, 0), b + 2)  # two points at least
        found = Density.of(self.belief.grid[near], self.belief.log[..., near])
        w = weights(found.evidence, self._ends, self._scatter)
        self.mean = float(np.sum(w * found.mean))
        self.sigma = float(np.sqrt(np.sum(w * (found.var + (found.mean - self.mean) ** 2))))
        p = np.sum(np.exp(found.log - found.evidence[..., None]) * w[..., None], axis=1)
        usual = np.sum(p, axis=1)
        use = usual > _RARE * np.max(usual)
        self._ends = [end for end, used in zip(self._ends, use, strict=True) if used]
        each = -(-len(found.grid) // _CELLS)  # points of a cell
        n = -(-len(found.grid) // each)
        cells = np.pad(p[use], [(0, 0), (0, n * each - len(found.grid))])
        step = float(found.grid[1] - found.grid[0])
        self._step = each * step
        self._grid = float(found.grid[0]) + 0.5 * (each - 1) * step + self._step * np.arange(n)
        self._p = cells.reshape(len(cells), n, each).sum(axis=2)
        self._p /= np.sum(self._p)
        off = self._grid - self.mean
        self._moments = np.stack([self._p, self._p * off, self._p * off**2], axis=2)

    def next(self) -> Next:
        """Where the next pass out and back tells most."""
        total = np.sum(self._p, axis=0)
        n, step = len(self._grid), self._step
        below, above = np.interp([0.02, 0.98], np.cumsum(total) / np.sum(total), self._grid)
        scatter = self.search.scatter.usual
        low = min(max(below - _DEEPEST_M, self.search.hit), above)
        # Candidates are points of the grid, and others below it, so that depths are whole steps.
        first, last = ((h - self._grid[0]) / step for h in (low, above + scatter))
        places = np.unique(np.round(np.linspace(first, last, _CANDIDATES)).astype(int))
        highest = max(int(places[-1]), 0)
        depths: Array = step * np.arange(-highest, n - min(int(places[0]), 0), dtype=np.float64)
        heights = self._grid[0] + places * step
        speeds = self._speeds(heights, scatter)
        tables = {float(v): self._table(depths, float(v), scatter) for v in np.unique(speeds)}
        left = [
            self._expected(tables[float(v)][:, :, highest - k : highest - k + n])
            for k, v in zip(places, speeds, strict=True)
        ]
        best = int(np.argmin(left))
        deep = max(above - low, 0.0) + 3.0 * scatter  # wherever the way back goes
        longest = float(np.max(self.view.lengths(self._ends, np.array([deep]))))
        return Next(float(heights[best]), float(speeds[best]), longest)

    def _speeds(self, heights: Array, scatter: float) -> Array:
        """(k,) m/s at ``heights`` (k,): the fastest at which the break that is expected lasts long enough."""
        depth = np.maximum(self.mean - heights, max(self.sigma, scatter))
        usual = np.min(self.view.lengths(self._ends, depth), axis=0)
        speeds = sorted((self.search.fast, *(share * self.search.slow for share in SLOWER)))
        found = np.full(len(heights), speeds[0])
        for speed in speeds[1:]:
            found[usual >= POLLS_OF_A_BREAK * speed * self.search.period_s] = speed
        return found

    def _table(self, depths: Array, speed: float, scatter: float) -> Array:
        """(ends, classes, n) how likely each class of lengths is to be seen at ``depths`` (n,) m."""
        resolution = 0.7 * speed * self.search.period_s
        half = _CLASSES // 2
        longer = np.geomspace(resolution * half, max(self.chord, 2.0 * resolution * half), half)
        cuts = np.concatenate([resolution * np.arange(1, half), longer])
        found = np.zeros((len(self._ends), len(cuts) + 2, len(depths)))
        for off, share in zip((-1.2, 0.0, 1.2), (0.25, 0.5, 0.25), strict=True):
            lengths = self.view.lengths(self._ends, depths + off * scatter)
            untold = (depths > NEAR_M) | np.array([[end.kind == "other"] for end in self._ends])
            found += share * _classes(lengths, untold, cuts, resolution)
        return found

    def _expected(self, table: Array) -> float:
        """Variance (m^2) that is left, on average, after a pass of ``table`` (ends, classes, n)."""
        weight, first, second = np.sum(table @ self._moments, axis=0).T
        weight = np.maximum(weight, 1e-300)
        return float(np.sum(np.maximum(second - first**2 / weight, 0.0)))


@lru_cache(8)
def upright(chord: float) -> ToolInBeam:
    """An upright tool of this chord (m): the profiles of its ends are worked out once for all looks."""
    up, along = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    side = np.cross(up, along)
    return ToolInBeam(-up, side, up, side, 0.5 * chord, chord)


def _points(low: float, high: float) -> int:
    return min(int((high - low) / _FINE_M) + 2, _POINTS)


def _classes(length: Array, untold: NDArray[np.bool_], cuts: Array, resolution: float) -> Array:
    """(ends, classes, n) how likely a break of ``length`` (ends, n) m is seen between which of ``cuts`` (m);
    the first class is a miss, the last one of breaks whose length says nothing: ``untold`` (ends, n)."""
    missed = np.clip(1.0 - length / resolution, 0.0, 1.0)
    seen = np.where(untold, 0.0, 1.0 - missed)
    below = np.clip((cuts[:, None] - length[:, None]) / (_SPREAD * resolution) + 0.5, 0.0, 1.0)
    below *= seen[:, None]
    found = np.empty((len(length), len(cuts) + 2, length.shape[1]))
    found[:, 0] = missed
    found[:, 1] = below[:, 0]
    found[:, 2:-1] = np.diff(below, axis=1)
    found[:, -1] = 1.0 - missed - below[:, -1]
    return found
