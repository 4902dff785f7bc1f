"""Exact distances between segments and boxes or other segments, for many of them at a time."""

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array


def segment_box_distance(p0: Array, p1: Array, low: Array, high: Array) -> Array:
    """(n,) m: distance of the segments ``p0``-``p1`` (n, 3) to the box ``low``..``high`` (3,); 0 inside.

    The squared distance of a point on the segment is convex and piecewise quadratic in the segment's
    parameter; its derivative is continuous, piecewise linear and rising, with kinks only where a coordinate
    crosses a face. So the minimum is found exactly: between the two kinks where the derivative changes sign.
    """
    along = p1 - p0
    with np.errstate(all="ignore"):
        crossings = np.concatenate([(low - p0) / along, (high - p0) / along], axis=1)
    crossings = np.clip(np.where(np.isfinite(crossings), crossings, 0.0), 0.0, 1.0)
    ends = np.broadcast_to([0.0, 1.0], (len(p0), 2))
    t = np.sort(np.concatenate([ends, crossings], axis=1), axis=1)
    points = p0[:, None] + t[:, :, None] * along[:, None]
    slope = np.sum(_outside(points, low, high) * along[:, None], axis=2)
    # The last kink with a falling distance; the minimum lies between it and the next one.
    k = np.clip(np.sum(slope < 0.0, axis=1) - 1, 0, t.shape[1] - 2)
    rows = np.arange(len(p0))
    s0, s1, t0, t1 = slope[rows, k], slope[rows, k + 1], t[rows, k], t[rows, k + 1]
    rise = s1 - s0
    fraction = np.where(rise > 0.0, -s0 / np.where(rise > 0.0, rise, 1.0), 0.0)
    best = t0 + np.clip(fraction, 0.0, 1.0) * (t1 - t0)
    distance: Array = np.linalg.norm(_outside(p0 + best[:, None] * along, low, high), axis=1)
    return distance


def _outside(points: Array, low: Array, high: Array) -> Array:
    """Per coordinate: how far a point is above the box (positive), below it (negative), or 0 inside."""
    outside: Array = points - np.clip(points, low, high)
    return outside


def segments_in_union(p0: Array, p1: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """(n,) whether each segment ``p0``-``p1`` (n, 3) lies in the union of the boxes ``low``..``high`` (b, 3).

    Every box holds one stretch of the segment (Liang and Barsky's clipping); the stretches must cover it.
    """
    along = (p1 - p0)[:, None]
    with np.errstate(all="ignore"):
        a, b = (low - p0[:, None]) / along, (high - p0[:, None]) / along
    inside = (low <= p0[:, None]) & (p0[:, None] <= high)
    still = along == 0.0
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(a, b)).max(axis=2)
    leave = np.where(still, np.inf, np.maximum(a, b)).min(axis=2)
    enter = np.where((low <= high).all(axis=1), enter, np.inf)
    covered = np.zeros(len(p0))
    for _ in range(len(low)):
        reach = np.where((enter <= covered[:, None]) & (leave >= covered[:, None]), leave, -np.inf).max(
            axis=1
        )
        covered = np.maximum(covered, reach)
    # A start outside every box stays uncovered although its 0 was never reached.
    started = ((enter <= 0.0) & (leave >= 0.0)).any(axis=1)
    whole: NDArray[np.bool_] = started & (covered >= 1.0)
    return whole


def segment_segment_distance(p0: Array, p1: Array, q0: Array, q1: Array) -> Array:
    """(n,) m: smallest distance between the segments ``p0``-``p1`` and ``q0``-``q1``, (n, 3) each.

    Closed form with clamped parameters (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    # By coordinate, (3, n): three long rows are worked off several times as fast as n short ones.
    p0, p1, q0, q1 = (np.ascontiguousarray(ends.T) for ends in (p0, p1, q0, q1))
    d1, d2, r = p1 - p0, q1 - q0, p0 - q0
    a, e, f = _dot(d1, d1), _dot(d2, d2), _dot(d2, r)
    b, c = _dot(d1, d2), _dot(d1, r)
    tiny = 1e-18
    safe_a, safe_e = np.maximum(a, tiny), np.maximum(e, tiny)
    denominator = a * e - b * b
    parallel = denominator <= 1e-12 * safe_a * safe_e
    s = np.where(parallel, 0.0, _share((b * f - c * e) / np.where(parallel, 1.0, denominator)))
    t = _share((b * s + f) / safe_e)
    s = _share((b * t - c) / safe_a)
    gap = r + s * d1 - t * d2
    distance: Array = np.sqrt(_dot(gap, gap))
    return distance


def _share(along: Array) -> Array:
    """Between 0 and 1; NumPy's clip takes twice as long for a few numbers."""
    out: Array = np.minimum(np.maximum(along, 0.0), 1.0)
    return out


def _dot(a: Array, b: Array) -> Array:
    """(n,) of vectors (3, n)."""
    product: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product
