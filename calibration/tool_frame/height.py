"""The height at which the tool's end first meets a beam: its posterior from all passes near it.

For every height on a grid each pass, out and back, has a likelihood: the arm was off by its repeatability,
the depth below the first contact makes the length of the break, and the polls saw such a break or did not.
What is not known beside the height is walked through: the shape of the end, and how well the arm repeats.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from calibration.tool_frame.glimpse import LOST, Glimpse
from calibration.tool_frame.repeatability import Scatter
from calibration.tool_frame.standstills import SHARED
from calibration.tool_frame.tip import TipShape, ToolInBeam
from cell.poses import Array

_GRID = 321
_ZOOMS = 3
_ABOVE_M = 5e-4  # a pass that polls did not see may be so far below the first contact
NEAR_M = 8e-4  # deeper down, the length of a break tells little of the height, and shapes differ more
_FAR_LOG = 14.0  # of the logarithm of the density: what is less likely is left out


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


def first_contact(
    glimpses: Sequence[Glimpse],
    view: ToolInBeam,
    ends: Sequence[TipShape],
    scatter: Scatter,
    below: float,
    above: float,
) -> Density:
    """The density from ``glimpses`` of one beam and set; the height is expected in ``below .. above`` (m)."""
    low, high = below - _ABOVE_M, above + _ABOVE_M
    for _ in range(_ZOOMS):
        grid = np.linspace(low, high, _GRID)
        log = _log_density(glimpses, view, ends, scatter, grid)
        total = np.max(log - np.max(log), axis=(0, 1))
        likely = np.flatnonzero(total > -_FAR_LOG)
        a, b = max(int(likely[0]) - 3, 0), min(int(likely[-1]) + 3, _GRID - 1)
        if b - a > 0.5 * _GRID:
            break
        low, high = float(grid[a]), float(grid[b])
    step = float(grid[1] - grid[0])
    top = np.max(log, axis=2, keepdims=True)
    p = np.exp(log - top)
    total = np.sum(p, axis=2)
    mean = p @ grid / total
    var = np.einsum("esn,esn->es", p, (grid - mean[..., None]) ** 2) / total + step**2 / 12.0
    return Density(grid, log, top[..., 0] + np.log(total * step), mean, var)


def _log_density(
    glimpses: Sequence[Glimpse], view: ToolInBeam, ends: Sequence[TipShape], scatter: Scatter, grid: Array
) -> Array:
    """(E, S, n) logarithm of the likelihood of all passes for the heights ``grid`` (n,)."""
    found = np.zeros((len(ends), len(scatter.sigmas), len(grid)))
    points = scatter.sigmas / float(grid[1] - grid[0])
    groups: dict[int, list[Glimpse]] = {}
    for g in glimpses:
        if not g.hit or float(grid[0]) - g.height < 0.5 * view.chord:
            groups.setdefault(g.pair, []).append(g)
    for group in groups.values():
        seen = []
        for g in group:
            depth = grid - g.height
            chance = g.at(view.lengths(ends, depth, g.sense))
            if g.hit:  # deep down the end's shape is not as simple
                chance = np.where(depth > NEAR_M, np.maximum(chance, g.of_any(view.chord)), chance)
            seen.append(chance)
        own = np.sqrt(1.0 - SHARED) if len(seen) > 1 else 1.0
        together = np.prod([_blurred(chance, own * points) for chance in seen], axis=0)
        if len(seen) > 1:
            together = _blurred(together, np.sqrt(SHARED) * points)
        found += np.log(together).swapaxes(0, 1)
    return found


def _blurred(values: Array, points: Array) -> Array:
    """(S, E, n) ``values`` (S, E, n) or (E, n) folded with normals of ``points`` (S,) of the grid."""
    n, pad = values.shape[-1], int(np.ceil(4.0 * float(np.max(points)))) + 1
    longer = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(pad, pad)], mode="edge")
    size = next_fast_len(n + 2 * pad, real=True)
    omega = 2.0 * np.pi * rfftfreq(size)
    transfer = np.exp(-0.5 * (points[:, None, None] * omega) ** 2)
    found: Array = irfft(rfft(longer, size) * transfer, size)[..., pad : pad + n]
    return np.clip(found, LOST**2, 1.0)


def mixed(
    densities: Sequence[Density], ends: Sequence[TipShape], scatter: Scatter
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


def weights(evidence: Array, ends: Sequence[TipShape], scatter: Scatter) -> Array:
    """(E, S) how likely each end and scatter are after passes of ``evidence`` (E, S)."""
    log = evidence + np.log([[end.prior] for end in ends]) + scatter.log_prior
    found: Array = np.exp(log - np.max(log))
    return found / np.sum(found)
