"""How an edge and the strip beside it share one blurred profile: the strip's shade from the profile's shape.

An item's visible side lies between its upper face and the belt. Across it the picture rises from 0 (face) to
1 (belt) in two steps, the first of the unknown height ``shade``, the second a known width later. Its area
says where the middle of both steps is, whatever the blur; how the rise is spread about that middle says how
high the first one was. A strip much narrower than the blur says nothing, and then the answer is as vague.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.items.blurred_step import blurred_step
from calibration.items.middle import median
from cell.poses import Array

_GRID = 0.05
_SHADES = np.arange(-0.2, 1.2 + 1e-9, _GRID)
_USUAL, _SPREAD = 0.6, 0.35  # a side of which nothing is known: from above, light falls on the face
_BLURS = np.linspace(0.5, 2.5, 21)  # px
_NEAR = np.linspace(-0.12, 0.12, 5)  # px about a blur that the other side of the item shows
_SURE_PX = 0.06  # of it
_STEP = 0.5  # px
_FLATTEST = 0.05  # rise in 2 px; what is flatter is as unsure
_INDEPENDENT = 0.4  # of the samples of a profile; pixels are interpolated between
_NOISE = 0.004  # of the whole rise, at least: no edge is a sum of two Gaussians to the last


@dataclass(frozen=True)
class Shade:
    """``mean`` and ``sigma`` of the first step's share of the rise."""

    mean: float = _USUAL
    sigma: float = _SPREAD


def shade_of(profile: Array, width: float, blur_px: float | None = None) -> Shade:
    """From a mean ``profile`` (n,) of the rise about its middle, see :func:`about_middle`, with a strip of
    ``width`` px. ``blur_px`` is the standard deviation of the blur where another edge has shown it.

    The mean over all shades and blurs, weighed by how well they fit.
    """
    found = _weighed(_SHADES, profile, width, blur_px)
    if found.sigma < _GRID:
        fine = found.mean + np.linspace(-2.0 * _GRID, 2.0 * _GRID, len(_SHADES))
        found = _weighed(fine, profile, width, blur_px)
    return found


def _weighed(shades: Array, profile: Array, width: float, blur_px: float | None) -> Shade:
    u = _places(width)
    blurs = _BLURS if blur_px is None else blur_px + _NEAR
    a, b = shades[:, None, None], blurs[None, :, None]
    second = blurred_step((u - width * a) / b)
    # Shades and places on both sides of their middles: the first step is the second of the opposite shade.
    first = 1.0 - second[::-1, :, ::-1] if shades is _SHADES else blurred_step((u + width * (1.0 - a)) / b)
    model = a * first + (1.0 - a) * second
    misfit = np.sum((model - profile) ** 2, axis=2)
    noise = max(float(misfit.min()) / len(u), _NOISE**2)
    cost = 0.5 * _INDEPENDENT * (misfit - misfit.min()) / noise
    cost += 0.5 * ((shades - _USUAL) / _SPREAD)[:, None] ** 2
    if blur_px is not None:
        cost += 0.5 * (_NEAR / _SURE_PX)[None, :] ** 2
    weight = np.exp(cost.min() - cost).sum(axis=1)
    weight /= weight.sum()
    mean = float(weight @ shades)
    return Shade(mean, float(np.sqrt(weight @ (shades - mean) ** 2)))


def blur_of(profile: Array) -> float:
    """The standard deviation of the blur, px, of an edge with no strip beside it."""
    fine = np.linspace(_BLURS[0], _BLURS[-1], 5 * len(_BLURS))
    misfit = np.sum((blurred_step(_places(0.0) / fine[:, None]) - profile) ** 2, axis=1)
    return float(fine[int(np.argmin(misfit))])


def smear_of(profile: Array) -> float:
    """How long, px, an even smear is that rises as steeply as such an edge does at its middle."""
    u = _places(0.0)
    rise = profile[np.abs(u - 1.0) < 0.5 * _STEP] - profile[np.abs(u + 1.0) < 0.5 * _STEP]
    return 2.0 / max(float(rise[0]), _FLATTEST)


def about_middle(s: Array, rise: Array, middle: Array, width: float) -> Array:
    """The mean of profiles ``rise`` (k, m) at ``s`` (m,) px, each about its own ``middle`` (k,)."""
    u = _places(width)
    step = float(s[1] - s[0])
    at = (middle[:, None] + u[None, :] - s[0]) / step
    at = np.clip(at, 0.0, len(s) - 1.001)
    low: NDArray[np.int64] = at.astype(np.int64)
    part = at - low
    rows = np.arange(len(rise))[:, None]
    every = (1.0 - part) * rise[rows, low] + part * rise[rows, low + 1]
    return median(every.T)


def _places(width: float) -> Array:
    reach = np.ceil((width + 3.0) / _STEP) * _STEP
    return np.arange(-reach, reach + 1e-9, _STEP)
