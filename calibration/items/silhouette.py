"""The sides of a rim, and how far an item reaches beyond it in the picture by way of its own visible sides.

Seen from above at a slant, the foot of an item is its rim moved along the sight. Where the sight runs along a
side, the foot is moved far along the rim, so the strip that is seen beside it is cut slantwise at its end:
its width is that to the edge of the whole silhouette, the hull of rim and foot.
"""

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_SAME_SIDE = 0.87  # cosine between normals of one side
_BOWED_PX, _FEW = 0.6, 6  # RMS beside a straight side, and points that tell no direction
_PARALLEL = 1e-6  # sine of the angle between two sides
_TURNS = 0.7  # cosine: two sides that meet at such a corner are extended to it
_CORNER_PX = 8.0  # from where the corner is looked for
_CUT_PX = 0.3  # by which the silhouette has to cut a strip before it counts

Sides = NDArray[np.int64]


def sides_of(normal: Array, apart: NDArray[np.bool_]) -> Sides:
    """Numbers (n,) of the sides that the points belong to, -1 for those ``apart``: runs that hardly turn."""
    number = np.full(len(normal), -1, dtype=np.int64)
    first, made = -1, -1
    begin = int(np.argmax(apart))  # a side must not be cut where the numbering begins
    x, y, none = normal[:, 0].tolist(), normal[:, 1].tolist(), apart.tolist()
    for i in ((np.arange(len(normal)) + begin) % len(normal)).tolist():
        if none[i]:
            first = -1
            continue
        if first < 0 or x[i] * x[first] + y[i] * y[first] < _SAME_SIDE:
            first, made = i, made + 1
        number[i] = made
    return number


def numbers_of(sides: Sides) -> list[int]:
    """The numbers that are in ``sides`` (n,), in order."""
    return np.flatnonzero(np.bincount(sides[sides >= 0])).tolist()


def straightened(points: Array, normal: Array, sides: Sides) -> tuple[Array, Array]:
    """``points`` and ``normal`` (n, 2) as a straight line, or a slight bow, through each side has them.

    A normal that is off by a hundredth has the width of a strip wrong by tenths of a pixel.
    """
    p_out, n_out = points.copy(), normal.copy()
    for k in numbers_of(sides):
        own = np.flatnonzero(sides == k)
        if len(own) < _FEW:
            continue
        way = normal[own].sum(axis=0)
        way /= math.hypot(*way.tolist())
        along = np.array([-way[1], way[0]])
        middle = points[own].sum(axis=0) / len(own)
        x, y = np.stack([along, way]) @ (points[own] - middle).T
        curve, slope = _line(x, y)
        off = y - curve
        if math.sqrt(float(off @ off) / len(own)) > _BOWED_PX:
            curve, slope = _bow(x, y)
        n_out[own] = (way - slope[:, None] * along) / np.sqrt(1.0 + slope**2)[:, None]
        p_out[own] = middle + x[:, None] * along + curve[:, None] * way
    return p_out, n_out


def _line(x: Array, y: Array) -> tuple[Array, Array]:
    """The best line through points with means of 0: its ``y`` and its slope at each."""
    slope = float(x @ y) / max(float(x @ x), 1e-12)
    return slope * x, np.full(len(x), slope)


def _bow(x: Array, y: Array) -> tuple[Array, Array]:
    powers = np.stack([np.ones_like(x), x, x * x], axis=1)
    c = np.linalg.lstsq(powers, y, rcond=None)[0]
    return powers @ c, c[1] + 2.0 * c[2] * x


def with_corners(points: Array, normal: Array, sides: Sides) -> Array:
    """``points`` (n, 2) of the sides in order, with the corner where two sides that meet would cross.

    Points of no side are left out where there is such a corner.
    """
    known = np.flatnonzero(sides >= 0)
    if not len(known):
        return points
    of = sides[known]
    begins = np.flatnonzero(of != np.roll(of, 1)).tolist()
    out = [points[known[: begins[0] if begins else None]]]
    for k, end in zip(begins, [*begins[1:], len(known)], strict=True):
        here, before = int(known[k]), int(known[k - 1])
        corner = _crossing(points[before], normal[before], points[here], normal[here])
        between = np.arange(before + 1, here if here > before else here + len(points)) % len(points)
        out.append(points[between] if corner is None else corner[None, :])
        out.append(points[known[k:end]])
    return np.concatenate(out)


def _crossing(p: Array, n: Array, q: Array, m: Array) -> Array | None:
    # Opposite sides may follow each other where one between them is hidden: they do not cross.
    (a, b), (c, d) = n.tolist(), m.tolist()
    sine = a * d - b * c
    if a * c + b * d > _TURNS or abs(sine) < _PARALLEL:
        return None
    (u, v), (x, y) = p.tolist(), q.tolist()
    first, second = a * u + b * v, c * x + d * y
    corner = (first * d - second * b) / sine, (second * a - first * c) / sine
    away = math.hypot(corner[0] - 0.5 * (u + x), corner[1] - 0.5 * (v + y))
    return np.array(corner) if away < _CORNER_PX else None


def strip_widths(
    points: Array, normal: Array, rim: Array, foot: Callable[[Array], Array]
) -> tuple[Array, NDArray[np.bool_]]:
    """How far the item reaches beyond its rim at ``points`` (n, 2) along ``normal`` (n, 2), px, and whether
    one side alone is seen there. ``foot(points)`` (n, 2) are those below; ``rim`` (m, 2) is all of it."""
    own = np.sum((foot(points) - points) * normal, axis=1)
    hull = cv2.convexHull(np.concatenate([rim, foot(rim)]).astype(np.float32))[:, 0, :].astype(float)
    way = np.roll(hull, -1, axis=0) - hull
    out = np.column_stack([way[:, 1], -way[:, 0]])
    if np.sum(out * (hull - hull.mean(axis=0))) < 0.0:
        out = -out
    facing = normal @ out.T
    ahead = np.sum(hull * out, axis=1)[None, :] - points @ out.T
    leave = np.min(np.where(facing > 1e-9, ahead / np.where(facing > 1e-9, facing, 1.0), np.inf), axis=1)
    seen = own > 0.0
    cut = seen & (leave < own - _CUT_PX)
    width = np.where(cut, np.maximum(leave, 0.0), np.maximum(own, 0.0))
    return width, ~(seen & (leave > own + 2.0 * _CUT_PX))
