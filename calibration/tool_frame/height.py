"""The height at which the tool's end first meets a beam: its posterior from all passes near it.

For every height on a grid each pass, out and back, has a likelihood: the arm was off by its repeatability,
the depth below the first contact makes the length of the break, and the polls saw such a break or did not.
What is not known beside the height is walked through: the shape of the end, and how well the arm repeats.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import ndtr

from calibration.tool_frame.glimpse import Glimpse
from calibration.tool_frame.repeatability import PassScatter
from calibration.tool_frame.standstills import SHARED
from calibration.tool_frame.tip import TipShape, ToolInBeam
from cell.poses import Array

_POINTS = 321
_ZOOMS = 3
ABOVE_M = 5e-4  # a pass that polls did not see may be so far below the first contact
NEAR_M = 8e-4  # deeper down, the length of a break tells little of the height, and shapes differ more
_FAR_LOG = 14.0  # of the logarithm of the density: what is less likely is left out
_NARROW = 0.05  # points of the grid: as good as no normal at all
_NOTHING = 1e-16  # beside LOST squared, the least of all, a share so small adds 1e-10 of it
_SHORT, _STRETCH = 27, 107  # points of the grid that are blurred at once: few where few beside them count


@dataclass(frozen=True, eq=False)
class Density:
    """The height (m) of one first contact for each of E ends and S scatters.

    ``evidence`` (E, S) is the logarithm of how likely the passes are, ``mean`` and ``var`` (E, S) are of the
    height; ``grid`` (n,) m and ``log`` (E, S, n) the density itself.
    """

    grid: Array
    log: Array
    evidence: Array
    mean: Array
    var: Array

    @classmethod
    def of(cls, grid: Array, log: Array) -> "Density":
        """``log`` up to what all have in common."""
        step = float(grid[1] - grid[0])
        top = np.max(log, axis=2, keepdims=True)
        p = np.exp(log - top)
        total = np.sum(p, axis=2)
        mean = p @ grid / total
        var = np.einsum("esn,esn->es", p, (grid - mean[..., None]) ** 2) / total + step**2 / 12.0
        return cls(grid, log, top[..., 0] + np.log(total * step), mean, var)


def first_contact(
    glimpses: Sequence[Glimpse],
    view: ToolInBeam,
    ends: Sequence[TipShape],
    scatter: PassScatter,
    below: float,
    above: float,
) -> Density:
    """The density from ``glimpses`` of one beam and set; the height is expected in ``below .. above`` (m)."""
    low, high = below - ABOVE_M, above + ABOVE_M
    hits = [g.likely_length for g in glimpses if g.hit]
    usual = float(np.median(hits)) if hits else None
    for _ in range(_ZOOMS):
        grid = np.linspace(low, high, _POINTS)
        log = log_likelihood(glimpses, view, ends, scatter, grid, usual)
        a, b = likely(log)
        a, b = max(a - 3, 0), min(b + 3, _POINTS - 1)
        if b - a > 0.5 * _POINTS:
            break
        low, high = float(grid[a]), float(grid[b])
    return Density.of(grid, log)


def likely(log: Array) -> tuple[int, int]:
    """The first and the last place of a grid whose density is not out of question; ``log`` (E, S, n)."""
    places = np.flatnonzero(np.max(log, axis=(0, 1)) > np.max(log) - _FAR_LOG)
    return int(places[0]), int(places[-1])


def log_likelihood(
    glimpses: Sequence[Glimpse],
    view: ToolInBeam,
    ends: Sequence[TipShape],
    scatter: PassScatter,
    grid: Array,
    usual: float | None = None,
) -> Array:
    """(E, S, n) logarithm of the likelihood of all passes for the heights ``grid`` (n,). ``usual`` (m) is how
    long they were broken on the whole: of an end that is of no known shape, no more is expected."""
    near = [g for g in glimpses if not g.hit or float(grid[0]) - g.height < 0.5 * view.chord]
    found = np.zeros((len(scatter.sigmas), len(ends), len(grid)))
    rows, row = _different(_chances(near, view, ends, grid, usual))
    together: dict[int, list[int]] = {}
    for k, g in enumerate(near):
        together.setdefault(g.pair, []).append(k)
    points = scatter.sigmas / float(grid[1] - grid[0])
    for ways in {len(group) for group in together.values()}:
        groups = np.array([group for group in together.values() if len(group) == ways])
        of_ways = row[groups].swapaxes(0, 1).reshape(ways, -1)  # of each group and end
        same, which = np.unique(of_ways, axis=1, return_inverse=True)
        often = np.zeros((len(ends), same.shape[1]))
        np.add.at(often, (np.tile(np.arange(len(ends)), len(groups)), which.ravel()), 1.0)
        own = np.sqrt(1.0 - SHARED) * points if ways > 1 else points
        for each, one, all_ways in zip(found, own, np.sqrt(SHARED) * points, strict=True):
            seen = np.prod(_blurred(rows, one)[same], axis=0)
            each += often @ np.log(seen if ways == 1 else _blurred(seen, all_ways))
    return found.swapaxes(0, 1)


def _different(chances: Iterable[Array]) -> tuple[Array, NDArray[np.intp]]:
    """The rows (r, n) of ``chances`` (E, n) that differ, and which it is of each pass and end (k, E).

    Most ends are the same to most passes."""
    place: dict[bytes, int] = {}
    rows: list[Array] = []
    found = []
    for chance in chances:
        own = []
        for line in chance:
            k = place.setdefault(line.tobytes(), len(rows))
            if k == len(rows):
                rows.append(line)
            own.append(k)
        found.append(own)
    return np.array(rows), np.array(found, dtype=np.intp)


def _chances(
    glimpses: Sequence[Glimpse],
    view: ToolInBeam,
    ends: Sequence[TipShape],
    grid: Array,
    usual: float | None,
) -> Iterator[Array]:
    """For each of ``glimpses`` (E, n) how likely its polls are with an arm that is where it should be."""
    depth = grid - np.array([[g.height] for g in glimpses]).reshape(-1, 1)
    lengths = np.empty((len(ends), *depth.shape))
    senses = np.array([g.sense for g in glimpses])
    for sense in set(senses.tolist()):
        own = senses == sense
        lengths[:, own] = view.lengths(ends, depth[own], sense)
    others = np.array([[end.kind == "other"] for end in ends])
    for k, g in enumerate(glimpses):
        chance = g.at(lengths[:, k])
        if g.hit:  # deep down the end's shape is not as simple
            far, unknown = depth[k] > NEAR_M, others & (depth[k] > 0.0)
            of_any = g.of_any(view.chord)
            chance = np.where(far, np.maximum(chance, of_any), chance)
            as_usual = 0.0 if usual is None else float(g.at(np.array(usual)))
            chance = np.where(unknown, max(of_any, as_usual), chance)
        yield chance


def _blurred(rows: Array, points: float) -> Array:
    """``rows`` (r, n) folded with a normal of ``points`` of their grid; beyond its ends it is as it is there.

    A point takes what its cell of the grid has of the normal; that adds the cell's own variance, which is
    taken from the normal's. By products with matrices, stretch by stretch, of the points that are near enough
    to count: at this size Fourier transforms take longer, and leave noise where the values are small."""
    found = np.empty_like(rows)
    for near, there, shares in _stretches(points, rows.shape[1]):
        np.matmul(rows[:, near], shares, out=found[:, there])
    return found


@lru_cache(16)
def _stretches(points: float, n: int) -> list[tuple[slice, slice, Array]]:
    """Of one normal: which points (k) of the grid count for which stretch (m) of it, and how much (k, m).

    Kept, as a search looks at one grid again and again."""
    below = ndtr((np.arange(-n, n) + 0.5) / np.sqrt(max(points**2 - 1.0 / 12.0, _NARROW**2)))
    reach = int(np.count_nonzero(below[:n] > _NOTHING))
    shares = np.diff(below)  # of the distances 1 - n .. n - 1
    matrix = sliding_window_view(shares, n)[::-1]  # (from, to)
    parts, stretch = [], min(max(2 * reach, _SHORT), _STRETCH)
    for first in range(0, n, stretch):
        begin, end = max(first - reach, 0), min(first + stretch + reach, n)
        there = slice(first, first + stretch)
        part = matrix[begin:end, there].copy()
        if begin == 0:
            part[0] += below[n - 1 :: -1][there]
        if end == n:
            part[-1] += below[:n][there]
        parts.append((slice(begin, end), there, part))
    return parts


def mixed(
    densities: Sequence[Density], ends: Sequence[TipShape], scatter: PassScatter
) -> tuple[Array, Array, Array]:
    """Heights with one end and one arm behind them all: their mean (k,), covariance (k, k), and the weights
    (E, S) of ends and scatters. What the end leaves open is common to the heights, and in the covariance."""
    weight = weights(sum((d.evidence for d in densities), np.zeros(())), ends, scatter)
    means = np.stack([d.mean for d in densities])
    mean = np.einsum("es,kes->k", weight, means)
    off = means - mean[:, None, None]
    cov = np.einsum("es,ies,jes->ij", weight, off, off)
    cov += np.diag([float(np.sum(weight * d.var)) for d in densities])
    return mean, cov, weight


def weights(evidence: Array, ends: Sequence[TipShape], scatter: PassScatter) -> Array:
    """(E, S) how likely each end and scatter are after passes of ``evidence`` (E, S)."""
    log = evidence + np.log([[end.prior] for end in ends]) + scatter.log_prior
    found: Array = np.exp(log - np.max(log))
    return found / np.sum(found)
