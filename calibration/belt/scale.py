"""Belt calibration: travel of one count and direction of the belt, from items seen while it moves.

A point fixed on the belt is at ``p0 + s n`` for the unwrapped count n; s is ``m_per_count * dir``. The counts
are certain beside the camera, so this is a straight regression with one slope vector and one p0 per item.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from calibration.refusal import Refusal
from cell.poses import Array

FOLDS = 5
_FEWEST = 3
_TRAVEL = 0.02  # m; over less, the camera's noise is the answer
_TUKEY = 4.685
_FAR = 4.5  # standard deviations
_ROUNDS = 20


@dataclass(frozen=True)
class BeltScale:
    """``m_per_count`` (m, positive) and ``direction`` (d,), a unit vector in base along which counts grow.

    ``half_scale`` (m) and ``half_angle`` (rad) are half of the 95 % intervals, the angle in each plane
    through the direction; None where the noise is not known. ``cov`` (d, d) belongs to the vector
    ``m_per_count * direction``. ``sigma`` is the scatter of a sighting per axis, ``heldout`` the RMS distance
    of sightings from solutions that did not see them, ``travel`` the longest way of one item (m).
    """

    m_per_count: float
    direction: Array
    half_scale: float | None
    half_angle: float | None
    cov: Array | None
    sigma: float | None
    heldout: float | None
    travel: float
    used: NDArray[np.bool_]
    distance: Array


def fit_scale(
    points: ArrayLike, counts: ArrayLike, items: ArrayLike | None = None, doubt: bool = True
) -> BeltScale | Refusal:
    """From sightings: ``points`` (k, 2 or 3) in base (m), unwrapped ``counts`` (k,), ``items`` (k,) numbers.

    Tukey's weights find false sightings; the answer is a plain fit without them. Without ``doubt`` all are
    taken as they are: a few touches do not show which of them is false.
    """
    p, n = np.asarray(points, dtype=float), np.asarray(counts, dtype=float)
    _, item = np.unique(np.zeros(len(p)) if items is None else np.asarray(items), return_inverse=True)
    often = np.bincount(item, minlength=1)[item] >= 2 if len(p) else np.zeros(0, dtype=bool)
    if often.sum() < _FEWEST:
        return Refusal(
            "too-few-sightings", f"{often.sum()} sightings of items seen twice; {_FEWEST} are needed"
        )
    used = often & _plausible(p, n, item, often) if doubt else often
    if used.sum() - len(np.unique(item[used])) < 2:
        return Refusal("sightings-disagree", "fewer than three sightings agree on how the belt moves")
    s, Sxx = _slope(p[used], n[used], item[used])
    m = float(np.linalg.norm(s))
    travel = m * max(float(np.ptp(n[used & (item == i)])) for i in np.unique(item[used]))
    if travel < _TRAVEL:
        words = (
            f"the items moved {1e3 * travel:.1f} mm while they were seen; let them move {1e3 * _TRAVEL:.0f}"
        )
        return Refusal(
            "no-travel", f"{words} mm at least, speed and direction of the belt are not observable"
        )
    r = _residuals(p, n, item, used, s)
    d = p.shape[1]
    freedom = d * (int(used.sum()) - len(np.unique(item[used]))) - d
    variance = float(np.sum(r[used] ** 2)) / freedom
    reach = float(stdtrit(freedom, 0.975)) * np.sqrt(variance / Sxx)
    return BeltScale(
        m_per_count=m,
        direction=s / m,
        half_scale=float(reach),
        half_angle=float(reach / m),
        cov=np.eye(d) * variance / Sxx,
        sigma=float(np.sqrt(variance)),
        heldout=_held_out(p, n, item, used),
        travel=travel,
        used=used,
        distance=np.linalg.norm(r, axis=1),
    )


def two_points(
    first: ArrayLike, second: ArrayLike, counts: tuple[int, int], sigma: float | None = None
) -> BeltScale | Refusal:
    """From one item touched twice: at ``first`` and ``second`` (d,) with the unwrapped ``counts``.

    Two points leave no residual: the intervals come from ``sigma`` (m, per axis of a touched point) when it
    is given, else there are none.
    """
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    n = counts[1] - counts[0]
    way = float(np.linalg.norm(b - a))
    if n == 0 or way < _TRAVEL:
        words = f"{1e3 * way:.1f} mm and {abs(n)} counts lie between the two points; move the belt further"
        return Refusal("no-travel", words)
    s = (b - a) / n
    m = float(np.linalg.norm(s))
    reach = None if sigma is None else 1.96 * np.sqrt(2.0) * sigma / abs(n)
    return BeltScale(
        m_per_count=m,
        direction=s / m,
        half_scale=None if reach is None else float(reach),
        half_angle=None if reach is None else float(reach / m),
        cov=None if sigma is None else np.eye(len(a)) * 2.0 * sigma**2 / n**2,
        sigma=sigma,
        heldout=None,
        travel=way,
        used=np.ones(2, dtype=bool),
        distance=np.zeros(2),
    )


def _slope(p: Array, n: Array, item: NDArray[np.int64], w: Array | None = None) -> tuple[Array, float]:
    """The common slope (d,) and the sum of squares of the counts about each item's mean."""
    w = np.ones(len(n)) if w is None else w
    total = np.bincount(item, w)
    mean_n = np.bincount(item, w * n) / np.where(total > 0.0, total, 1.0)
    x = n - mean_n[item]
    Sxx = float(np.sum(w * x * x))
    return (w * x) @ p / max(Sxx, 1e-300), Sxx


def _residuals(p: Array, n: Array, item: NDArray[np.int64], used: NDArray[np.bool_], s: Array) -> Array:
    """Distance vectors (k, d) from the motion of each point's own item, which ``used`` rows place."""
    origin = p - n[:, None] * s
    out = np.full_like(p, np.nan)
    for i in np.unique(item[used]):
        own = item == i
        out[own] = origin[own] - origin[own & used].mean(axis=0)
    return out


def _plausible(p: Array, n: Array, item: NDArray[np.int64], often: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Rows that fit the motion of the others, found with Tukey's weights from a median start."""
    s = _median_slope(p, n, item)
    keep = often.copy()
    scale = 1e-5
    items = [np.flatnonzero(item == i) for i in np.unique(item[often])]
    for _ in range(_ROUNDS):
        origin = p - n[:, None] * s
        off = np.zeros_like(p)
        for own in items:
            off[own] = origin[own] - _median(origin[own])
        r = np.linalg.norm(off, axis=1)
        scale = max(float(_median(r[often])) / 1.18, 1e-5)  # of a normal error in two directions
        w = np.where(often & (r < _TUKEY * scale), (1.0 - (r / (_TUKEY * scale)) ** 2) ** 2, 0.0)
        if w.sum() == 0.0:
            break
        s, _ = _slope(p, n, item, w)
        keep = often & (r < _FAR * scale)
    return keep


def _median(x: Array) -> Array:
    """Along the first axis of finite numbers; the library's takes five times as long for so few."""
    ordered, k = np.sort(x, axis=0), len(x) // 2
    out: Array = ordered[k] if len(x) % 2 else 0.5 * (ordered[k - 1] + ordered[k])
    return out


def _median_slope(p: Array, n: Array, item: NDArray[np.int64]) -> Array:
    """Median over the pairs of each item's sightings of their slope; half of the pairs may be wrong."""
    slopes = []
    for i in np.unique(item):
        rows = np.flatnonzero(item == i)
        a, b = np.triu_indices(len(rows), 1)
        dn = n[rows[b]] - n[rows[a]]
        far = np.abs(dn) >= 0.25 * max(float(np.abs(dn).max(initial=0.0)), 1.0)
        slopes.append((p[rows[b]] - p[rows[a]])[far] / dn[far, None])
    every = np.concatenate(slopes)
    return np.asarray(np.median(every, axis=0)) if len(every) else np.zeros(p.shape[1])


def _held_out(p: Array, n: Array, item: NDArray[np.int64], used: NDArray[np.bool_]) -> float | None:
    """RMS distance of each fold from the motion that the other folds show; None with too few sightings."""
    rows = np.flatnonzero(used)
    if len(rows) < 2 * FOLDS:
        return None
    squares = []
    for k in range(FOLDS):
        rest = used.copy()
        rest[rows[k::FOLDS]] = False
        s, _ = _slope(p[rest], n[rest], item[rest])
        r = _residuals(p, n, item, rest, s)[rows[k::FOLDS]]
        squares.append(np.sum(r * r, axis=1))
    found = np.concatenate(squares)
    found = found[np.isfinite(found)]
    return float(np.sqrt(found.mean())) if len(found) else None
