"""The rim of an upper face, moved from where depth has it to the edge that colour shows.

Across the rim the picture goes from the face's colour to the belt's, on the sides that the camera sees by way
of the item's side, a strip whose width is known from the item's height. The edge is found from the area under
that profile, so neither the lens nor motion during the exposure, which blur both ways alike, move it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_POINTS = 160  # along the rim
_INWARD, _OUTWARD, _MOST_SIDE = 6.0, 5.0, 24.0  # px
_STEP = 0.25
_JAGGED = 4.0  # points: depth's own rim
_LEAST_CONTRAST = 15.0  # grey levels between face and belt
_SHADE = 0.6  # of the way from the face's colour to the belt's: a side of which nothing is known
_WIDE = 5.0  # px; a strip whose own colour can be read
_ALIKE = 0.8  # cosine between normals of one side
_ROUNDS = 2
_CORNER, _SHARP = 7, 0.7  # points before and after, and the cosine of how far the rim may turn between them
_FEWEST = 0.4  # of the points must show an edge
_FARTHEST = 4.0  # px from where depth has the rim
_SYSTEMATIC_PX = 0.15  # what is left of the sides' influence on the centre, on drawn boxes

SideWidth = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Rim:
    """``points`` (n, 2) px in order around the face; ``sigma_px`` of their centre, per axis."""

    points: Array
    sigma_px: float


def measured_rim(colour: NDArray[np.uint8], face: NDArray[np.bool_], side_width: SideWidth) -> Rim | None:
    """The rim in ``colour`` (h, w, 3) of ``face`` (h, w); None when colour shows no edge there.

    ``side_width(points, normals)`` (n,) px is how far the item's side reaches beyond the rim at ``points``
    (n, 2) along outward ``normals`` (n, 2).
    """
    contours, _ = cv2.findContours(face.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    inner = cv2.erode(face.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
    if not contours or inner.sum() < 20:
        return None
    contour = max(contours, key=len)[:, 0, :].astype(float)
    own = np.median(colour[inner].reshape(-1, 3), axis=0)
    found: Rim | None = None
    # From depth's rim first, which bulges where a side was taken for the top; then from what that came to.
    for _ in range(_ROUNDS):
        found = _moved(colour, own, contour, side_width)
        if found is None:
            return None
        contour = found.points
    return found


def _moved(colour: NDArray[np.uint8], own: Array, contour: Array, side_width: SideWidth) -> Rim | None:
    """A closed ``contour`` (k, 2) px moved to the edge of the face, whose colour is ``own`` (3,)."""
    start, normal = _evenly(contour)
    side = np.clip(side_width(start, normal), 0.0, _MOST_SIDE)
    s = np.arange(-_INWARD, _OUTWARD + float(side.max()) + 1e-9, _STEP)
    seen = _profiles(colour, start, normal, s)
    beyond = s[None, :] > side[:, None] + 3.0
    belt = np.median(seen[beyond], axis=0)
    contrast = float(np.linalg.norm(belt - own))
    if contrast < _LEAST_CONTRAST:
        return None
    rise = ((seen - own) @ (belt - own)) / contrast**2  # 0 on the face, 1 on the belt
    shift = _edge(s, rise, side, _shades(s, rise, side, normal))
    good = (np.abs(shift) < _FARTHEST) & ~_corners(normal)
    if good.mean() < _FEWEST:
        return None
    everywhere = np.interp(np.arange(len(shift)), np.flatnonzero(good), shift[good], period=len(shift))
    smooth = _around(everywhere, 3.0)
    off = shift - smooth
    spread = 1.4826 * float(np.median(np.abs(off[good]))) + 0.02
    shift = np.where(good & (np.abs(off) < 4.0 * spread), shift, smooth)
    sigma_px = float(np.hypot(spread * np.sqrt(2.0 / good.sum()), _SYSTEMATIC_PX))
    return Rim(start + shift[:, None] * normal, sigma_px)


def _profiles(colour: NDArray[np.uint8], start: Array, normal: Array, s: Array) -> Array:
    """Colours (n, k, 3) at ``s`` (k,) px outward from ``start`` (n, 2)."""
    where = (start[:, None, :] + s[None, :, None] * normal[:, None, :]).astype(np.float32)
    seen: Array = cv2.remap(
        colour.astype(np.float32),
        where[..., 0],
        where[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return seen


def _edge(s: Array, rise: Array, side: Array, shade: Array) -> Array:
    """Where the face ends (n,), px along ``s``: what the area under ``rise`` says, less the side's part."""
    end = side + _OUTWARD
    rows = np.arange(len(side))
    slices = 0.5 * _STEP * (rise[:, 1:] + rise[:, :-1])
    grown = np.concatenate([np.zeros((len(side), 1)), np.cumsum(slices, axis=1)], axis=1)
    k = np.minimum(((end - s[0]) / _STEP).astype(int), len(s) - 2)
    area = grown[rows, k] + (end - s[k]) * rise[rows, k]
    return np.asarray(end - area - side * (1.0 - shade))


def _shades(s: Array, rise: Array, side: Array, normal: Array) -> Array:
    """How far each side's colour is on the way from the face's to the belt's (n,).

    A strip that is wide enough is read; a narrow one is taken to be as its neighbours on the same side of
    the item, as the item's other sides, or as most sides are.
    """
    wide = side > _WIDE
    if not wide.any():
        return np.full(len(side), _SHADE)
    edge = _edge(s, rise, side, np.full(len(side), _SHADE))
    for _ in range(2):
        middle = (s[None, :] > edge[:, None] + 2.0) & (s[None, :] < (edge + side)[:, None] - 2.0)
        count = np.maximum(middle.sum(axis=1), 1)
        own = np.clip(np.sum(np.where(middle, rise, 0.0), axis=1) / count, 0.0, 1.2)
        known = wide & (middle.sum(axis=1) > 0)
        if not known.any():
            return np.full(len(side), _SHADE)
        alike = (normal @ normal[known].T) > _ALIKE
        shade = np.where(alike.any(axis=1), _medians(own[known], alike), float(np.median(own[known])))
        edge = _edge(s, rise, side, shade)
    return shade


def _medians(values: Array, chosen: NDArray[np.bool_]) -> Array:
    """The median of those of ``values`` (k,) that each row of ``chosen`` (n, k) names; inf for none."""
    ordered = np.sort(np.where(chosen, values, np.inf), axis=1)
    count, rows = chosen.sum(axis=1), np.arange(len(chosen))
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(values) - 1)
    return np.asarray(0.5 * (ordered[rows, low] + ordered[rows, high]))


def _evenly(contour: Array) -> tuple[Array, Array]:
    """Points (n, 2) evenly along a closed ``contour`` and their outward unit normals (n, 2)."""
    closed = np.vstack([contour, contour[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0.0, length[-1], _POINTS, endpoint=False)
    points = np.column_stack([np.interp(at, length, closed[:, axis]) for axis in (0, 1)])
    points = np.column_stack([_around(points[:, axis], 1.0) for axis in (0, 1)])
    smooth = np.column_stack([_around(points[:, axis], _JAGGED) for axis in (0, 1)])
    tangent = np.roll(smooth, -1, axis=0) - np.roll(smooth, 1, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    outward = np.sum(normal * (points - points.mean(axis=0)), axis=1)
    return points, normal if np.median(outward) > 0.0 else -normal


def _corners(normal: Array) -> NDArray[np.bool_]:
    """(n,) where the rim turns within few points: across a corner a side is not as wide as beside it."""
    before, after = np.roll(normal, _CORNER, axis=0), np.roll(normal, -_CORNER, axis=0)
    return np.asarray(np.sum(before * after, axis=1) < _SHARP)


def _around(values: Array, sigma: float) -> Array:
    """``values`` (n,) of a closed curve, smoothed by a Gaussian of ``sigma`` points."""
    k = np.arange(-int(3 * sigma) - 1, int(3 * sigma) + 2)
    kernel = np.exp(-0.5 * (k / sigma) ** 2)
    padded = np.concatenate([values[k[0] :], values, values[: k[-1]]])
    out: Array = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return out
