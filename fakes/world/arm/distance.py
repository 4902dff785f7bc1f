"""Least distances between line segments, many at once."""

import numpy as np

from cell.poses import Array

_TINY = 1e-18


def to_segments(axes: Array, centres: Array, directions: Array, halves: Array) -> Array:
    """Least distances (n, b, m), m, of ``axes`` (n, m, 2, 3), both ends, to b segments.

    A segment is its ``centres`` (b, 3), unit ``directions`` (b, 3) and half length ``halves`` (b,). The
    nearest points minimise a convex quadratic form on a rectangle: the free optimum along the axis clipped,
    then the one along the segment clipped, then the one along the axis again (Ericson, Real-Time Collision
    Detection, 5.1.9).
    """
    start, v = axes[:, None, :, 0], (axes[:, :, 1] - axes[:, :, 0])[:, None]  # (n, 1, m, 3)
    w = start - centres[None, :, None]  # (n, b, m, 3)
    u = directions[None, :, None]
    ww, vv, wv = _dot(w, w), _dot(v, v), _dot(w, v)
    wu, vu = _dot(w, u), _dot(v, u)
    across = vv - vu * vu
    s = np.where(across > _TINY, (wu * vu - wv) / np.maximum(across, _TINY), 0.0).clip(0.0, 1.0)
    half = halves[None, :, None]
    t = np.minimum(np.maximum(wu + s * vu, -half), half)
    s = ((t * vu - wv) / np.maximum(vv, _TINY)).clip(0.0, 1.0)
    squared = ww + s * s * vv + t * t + 2.0 * (s * wv - t * wu - s * t * vu)
    out: Array = np.sqrt(np.maximum(squared, 0.0))
    return out


def _dot(a: Array, b: Array) -> Array:
    out: Array = np.einsum("...i,...i->...", a, b)
    return out
