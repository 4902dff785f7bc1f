"""Where an item lies on the belt, from one sighting or several, in a frame that moves with the belt.

A sighting of ``xy`` at exposure says that the item's origin on the belt is ``xy - dir * travel(exposure)``;
the sightings of one item then agree but for the camera's noise and the time of exposure.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

NEWEST = 24  # sightings of an item, that tell where and how it lies
CAMERA_SIGMA = 3e-4  # m; until the sightings of one item tell
LATENCY_SIGMA = 5e-3  # s; until exposures that are known tell
_FEWEST = 8  # numbers that say how large a noise is
_LEAST_DEGREES = 3.0
_SMALLEST = 2e-5  # m
_FAR, _FAR_SIGMAS = 1.5e-3, 6.0  # m
_MANY = 5  # sightings of one item that show which of them lies far


@dataclass(frozen=True)
class Sighting:
    """One detection: ``xy`` (m, base) at ``t`` (s); ``late`` is its arrival minus exposure where both are
    known, ``sure`` whether the exposure is, else ``t`` was derived from the mean latency. ``sigma`` (m, along
    the worse axis) is what the detector states of this one; 0: it states nothing."""

    xy: tuple[float, float]
    t: float
    arrived: float
    sure: bool
    sigma: float = 0.0


@dataclass(frozen=True)
class Levels:
    """Standard deviations: of a sighting (m, per axis) and of a derived exposure (s).

    Of the variance that the detector states: ``scattered``, the share by which the sightings of one item
    truly scatter along the belt, and ``shared``, the share that all of them may have alike, as it does not
    scatter.
    """

    camera: float
    latency: float
    scattered: float = 1.0
    shared: float = 1.0


@dataclass(frozen=True)
class BeltPlace:
    """An item on the belt: ``along`` and ``across`` (m) where travel is zero; variances of both (m^2).

    ``at`` is the exposure from which its travel is counted for the uncertainty (that of the newest
    sighting in use), ``used`` which sightings it was made of. ``var_shared`` (m^2) is in both variances: what
    the detector states beyond the scatter of an item's sightings may be wrong with all of them alike, and
    does not get less with their number.
    """

    along: float
    across: float
    var_along: float
    var_across: float
    at: float
    used: NDArray[np.bool_]
    var_shared: float = 0.0


def latency_sigma(sightings: Iterable[Sighting]) -> float:
    """Standard deviation of the latency, from the sightings whose exposure is known."""
    late = np.array([s.arrived - s.t for s in sightings if s.sure])
    if len(late) < _FEWEST:
        return LATENCY_SIGMA
    return max(float(np.std(late, ddof=1)) * _of_few(len(late) - 1), 1e-5)


@dataclass(frozen=True)
class Scatter:
    """How the sightings of one item scatter across the belt: variance (m^2), and its degrees of freedom."""

    variance: float
    degrees: int


def scatter(across: Array) -> Scatter | None:
    """Of sightings ``across`` (k,) the belt, m; None for a single one.

    One that lies far from many is no noise: it would hide itself, where no other item tells.
    """
    if len(across) >= _MANY:
        off = np.abs(across - np.median(across))
        across = across[off <= max(_FAR, _FAR_SIGMAS * 1.4826 * float(np.median(off)))]
    return Scatter(float(np.var(across, ddof=1)), len(across) - 1) if len(across) > 1 else None


def camera_sigma(items: Iterable[Scatter | None]) -> float:
    """Noise of a sighting, from how the sightings of each item scatter."""
    many = [item for item in items if item is not None]
    if sum(item.degrees for item in many) < _FEWEST:
        return CAMERA_SIGMA
    parts = np.array([item.variance for item in many])
    weights = np.array([float(item.degrees) for item in many])
    limit = 9.0 * max(float(np.median(parts)) / 0.6, _SMALLEST**2)  # a false sighting is no noise
    keep = parts <= limit
    noise = float(np.sqrt(np.average(parts[keep], weights=weights[keep])))
    return max(noise * _of_few(float(weights[keep].sum())), _SMALLEST)


def scattered(items: Iterable[Scatter | None]) -> tuple[float, float]:
    """:attr:`Levels.scattered` and :attr:`Levels.shared`, of ``items`` with variances as shares of what was
    stated. Both are all of it where too few tell.

    A scatter that is too small by chance would show as shared: it counts by a standard deviation more.
    """
    many = [item for item in items if item is not None]
    if sum(item.degrees for item in many) < _FEWEST:
        return 1.0, 1.0
    parts, weights = np.array([item.variance for item in many]), np.array([item.degrees for item in many])
    keep = parts <= 9.0 * float(np.median(parts)) / 0.6
    share, degrees = float(np.average(parts[keep], weights=weights[keep])), float(weights[keep].sum())
    return share * _of_few(degrees) ** 2, max(1.0 - share * (1.0 + float(np.sqrt(2.0 / degrees))), 0.0)


def _of_few(degrees: float) -> float:
    """By what to multiply a deviation that so many degrees of freedom tell: what is divided by it then has a
    mean square of one. With two there is no such mean."""
    degrees = max(degrees, _LEAST_DEGREES)
    return float(np.sqrt(degrees / (degrees - 2.0)))


def facing(yaws: Sequence[float]) -> float:
    """The axis of an item (rad, the same after half a turn) from several sightings of it.

    That one to which all others are closest: a mean would lie across the corners of an item as long as wide.
    """
    axes = np.array(yaws)
    off = np.abs((axes[:, None] - axes + np.pi / 2) % np.pi - np.pi / 2)
    return float(axes[np.argmin(off.sum(axis=1))])


def camera_variance(stated: Array, levels: Levels) -> Array:
    """(k,) m^2 along the belt of single sightings with ``stated`` (k,) m: as the detector has it, made as
    large as sightings truly scatter, and no less than they do across the belt."""
    return np.asarray(np.maximum(levels.scattered * stated**2, levels.camera**2))


def place(
    along: Array, across: Array, sightings: Sequence[Sighting], speed: Array, levels: Levels
) -> BeltPlace:
    """One item from its sightings: ``along`` and ``across`` (k,) in the belt's frame (travel taken off).

    ``speed`` (k,) is the belt's at each exposure: a derived exposure is uncertain by speed times latency.
    What the detector states counts along the belt, where items smear; across it the scatter of all tells.
    Of three or more sightings, one that lies far from the middle of them is left out.
    """
    sure = np.array([s.sure for s in sightings])
    stated = np.array([s.sigma for s in sightings])
    var_across = np.full(len(along), levels.camera**2)
    var_camera = camera_variance(stated, levels)
    var_along = var_camera + np.where(sure, 0.0, (np.asarray(speed) * levels.latency) ** 2)
    used = np.ones(len(along), dtype=bool)
    if len(along) >= 3:
        for values, variance in ((along, var_along), (across, var_across)):
            off = np.abs(values - np.median(values))
            used &= off <= np.maximum(_FAR, _FAR_SIGMAS * np.sqrt(variance))
        if not used.any():
            used[:] = True
    w = 1.0 / var_along[used]
    newest = max(s.t for s, u in zip(sightings, used, strict=True) if u)
    shared = levels.shared * float(np.mean(stated[used] ** 2))
    return BeltPlace(
        along=float(np.sum(w * along[used]) / np.sum(w)),
        across=float(np.mean(across[used])),
        var_along=float(1.0 / np.sum(w)) + shared,
        var_across=float(levels.camera**2 / used.sum()) + shared,
        at=newest,
        used=used,
        var_shared=shared,
    )
