"""The rim of an upper face, moved from where depth has it to the edge that colour shows.

Across the rim the picture goes from the face's colour to the belt's, on the sides that the camera sees by way
of the item's side, a strip whose width is known from the item's height. The edge is found from the area under
that profile, so neither the lens nor motion during the exposure, which blur both ways alike, move it. A
smear longer than the profile is seen only in part, and then the edge is the less sure the longer it is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.items.middle import median
from calibration.items.silhouette import (
    Sides,
    numbers_of,
    sides_of,
    straightened,
    strip_widths,
    with_corners,
)
from calibration.items.strip import Shade, about_middle, blur_of, shade_of, smear_of
from cell.poses import Array

_POINTS = 160  # along the rim
_INWARD, _OUTWARD = 6.0, 5.0  # px
_OWN, _BEYOND = 3.5, 3.0  # px from the edge, where the colours of face and belt are read
_STEP = 0.25
_JAGGED = 4.0  # points: depth's own rim
_LEAST_CONTRAST = 15.0  # grey levels across an edge
_WIDE = 12.0  # px; beyond, the edge between face and side is looked for alone
_HIDDEN = 0.3  # px; a side that is not seen
_BROAD = 0.75  # of its widest: where the shade of a strip is read
_OTHER = 0.25  # of the rise, by which a profile may miss the belt's colour: something lies beside the item
_ROUNDS, _SETTLED_PX = 3, 0.2
_CORNER, _SHARP = 7, 0.7  # points before and after, and the cosine of how far the rim may turn between them
_ACROSS = 0.87  # cosine between the normals of sides that are blurred alike
_FEWEST = 0.4  # of the points must show an edge
_FARTHEST = 6.0  # px from where depth has the rim
_UNSEEN_PX = 1.5  # of a rim that colour does not show: where depth has it
_UNSEEN_SIDE_PX = 5.0  # of a whole side: depth is fat there, or a hole has cut it off
_SEEN_SHARE = 0.3  # of a side's points, that make it one that colour shows
_WIDTH_PX = 0.15  # of a strip's width, by errors of height and attitude
_DIRECTIONS = 8
_SYSTEMATIC_PX = 0.15  # of each side, on drawn boxes
_WHOLE_PX, _SMEARED = 5.0, 0.35  # a smear that a profile holds; the error by each pixel that it is longer

Foot = Callable[[Array], Array]


@dataclass(frozen=True)
class Rim:
    """``points`` (n, 2) px in order around the face; ``sigma_px`` of their centre, along its worse axis;
    ``moved_px`` how far the rim lay from where it was looked for, RMS."""

    points: Array
    sigma_px: float
    moved_px: float


def measured_rim(colour: NDArray[np.uint8], face: NDArray[np.bool_], foot: Foot) -> Rim | None:
    """The rim in ``colour`` (h, w, 3) of ``face`` (h, w); None when colour shows no edge there.

    ``foot(points)`` (n, 2) px is where the belt is below ``points`` (n, 2) px of the rim.
    """
    contours, _ = cv2.findContours(face.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    contour = max(contours, key=len)[:, 0, :].astype(float)
    picture = colour.astype(np.float32)
    found: Rim | None = None
    # From depth's rim first, which bulges where a side was taken for the top; then from what that came to.
    for _ in range(_ROUNDS):
        found = _moved(picture, contour, foot)
        if found is None:
            return None
        if found.moved_px < _SETTLED_PX:
            break
        contour = found.points
    return found


def _moved(picture: NDArray[np.float32], contour: Array, foot: Foot) -> Rim | None:
    """A closed ``contour`` (k, 2) px moved to the edge of the face."""
    start, normal = _evenly(contour)
    corner = _corners(normal)
    sides = sides_of(normal, corner)
    start, normal = straightened(start, normal, sides)
    full, alone = strip_widths(start, normal, with_corners(start, normal, sides), foot)
    wide = _each_side(full, sides) > _WIDE
    side = np.where(wide, 0.0, full)
    s = np.arange(-_INWARD, _OUTWARD + float(side.max()) + 1e-9, _STEP)
    seen = _profiles(picture, start, normal, np.broadcast_to(s, (len(start), len(s))))
    own = _steady(np.mean(seen[:, s <= -_OWN], axis=1))
    there = _profiles(picture, start, normal, full[:, None] + np.arange(_BEYOND, _OUTWARD + 0.1, 0.5))
    belt = median(there.reshape(-1, 3).T)
    # Past a wide strip the belt is far away; what is beside the face then is the strip.
    next_to = _steady(np.mean(seen[:, (s >= _BEYOND) & (s <= _OUTWARD)], axis=1))
    beyond = np.where(wide[:, None], next_to, belt)
    contrast = np.linalg.norm(beyond - own, axis=1)
    way = (beyond - own) / np.maximum(contrast, 1e-9)[:, None] ** 2
    rise = (seen @ way[..., None])[..., 0] - np.sum(own * way, axis=1)[:, None]
    middle, last = _middle(s, rise, side)
    plain = (contrast > _LEAST_CONTRAST) & (np.abs(last - 1.0) < _OTHER) & ~corner & (alone | wide)
    shade, doubt, smear = _shades(s, rise, side, middle, normal, np.where(plain, sides, -1))
    shift = middle - side * (1.0 - shade)
    good = plain & (np.abs(shift) < _FARTHEST)
    if good.mean() < _FEWEST:
        return None
    everywhere = np.interp(np.arange(len(shift)), np.flatnonzero(good), shift[good], period=len(shift))
    smooth = _around(everywhere, 3.0)
    off = shift - smooth
    spread = 1.4826 * float(median(np.abs(off[good]))) + 0.02
    shift = np.where(good & (np.abs(off) < 4.0 * spread), shift, smooth)
    points = start + shift[:, None] * normal
    strip = np.where(side > _HIDDEN, np.hypot(side * doubt, _WIDTH_PX * (1.0 - shade)), 0.0)
    cut = np.hypot(_SYSTEMATIC_PX, _SMEARED * np.maximum(smear - _WHOLE_PX, 0.0))
    unsure = np.where(good | corner, np.hypot(strip, cut), _UNSEEN_PX)
    for k in numbers_of(sides):
        if np.mean(good[sides == k]) < _SEEN_SHARE:
            unsure[sides == k] = _UNSEEN_SIDE_PX
    moved = float(np.sqrt(np.mean(shift[good] ** 2)))
    sigma_px = _sigma(points, normal, unsure, sides, spread)
    # At a corner depth's rim bulges, and colour says nothing; where the sides would meet is better.
    return Rim(with_corners(*straightened(points, normal, sides), sides), sigma_px, moved)


def _profiles(picture: NDArray[np.float32], start: Array, normal: Array, s: Array) -> Array:
    """Colours (n, k, 3) at ``s`` (n, k) px outward from ``start`` (n, 2)."""
    where = (start[:, None, :] + s[..., None] * normal[:, None, :]).astype(np.float32)
    seen: Array = cv2.remap(
        picture,
        where[..., 0],
        where[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return seen


def _middle(s: Array, rise: Array, side: Array) -> tuple[Array, Array]:
    """Where the whole rise is on average (n,), px along ``s``, from the area under it up to the end of what
    belongs to the rim; and what it comes to there (n,)."""
    end = side + _OUTWARD
    rows = np.arange(len(side))
    slices = 0.5 * _STEP * (rise[:, 1:] + rise[:, :-1])
    grown = np.concatenate([np.zeros((len(side), 1)), np.cumsum(slices, axis=1)], axis=1)
    k = np.minimum(((end - s[0]) / _STEP).astype(int), len(s) - 2)
    area = grown[rows, k] + (end - s[k]) * rise[rows, k]
    back = np.maximum(k - round((_OUTWARD - _BEYOND) / _STEP), 0)
    last = (grown[rows, k] - grown[rows, back]) / np.maximum((k - back) * _STEP, _STEP)
    return np.asarray(end - area), np.asarray(last)


def _each_side(values: Array, sides: Sides) -> Array:
    """``values`` (n,) with those of one side replaced by their median."""
    out = values.copy()
    for k in numbers_of(sides):
        out[sides == k] = median(values[sides == k])
    return out


def _shades(
    s: Array, rise: Array, side: Array, middle: Array, normal: Array, sides: Sides
) -> tuple[Array, Array, Array]:
    """How far each side's colour is on the way from the face's to the belt's (n,), how unsure that is, and
    over how many pixels the edge is smeared.

    Sides that are not seen show blur and smear, which are the same on the side across.
    """
    shade, doubt, smear = np.zeros((3, len(side)))
    widths = {k: float(np.max(side[sides == k])) for k in numbers_of(sides)}
    blurs: list[tuple[Array, float, float]] = []
    for k, width in sorted(widths.items(), key=lambda pair: pair[1]):
        own = sides == k
        way = np.mean(normal[own], axis=0)
        across = [blur for n, *blur in blurs if abs(float(n @ way)) > _ACROSS]
        found = Shade()
        if width < _HIDDEN:
            edge = about_middle(s, rise[own], middle[own], 0.0)
            blurs.append((way, blur_of(edge), smear_of(edge)))
            smear[own] = blurs[-1][2]
        else:
            broad = own & (side > _BROAD * width)  # at its end a strip may be cut
            usual = float(median(side[broad]))
            profile = about_middle(s, rise[broad], middle[broad], usual)
            found = shade_of(profile, usual, across[0][0] if across else None)
            smear[own] = across[0][1] if across else 0.0
        shade[own], doubt[own] = found.mean, found.sigma
    known = sides >= 0
    if known.any() and not known.all():
        at = np.arange(len(side))
        shade, doubt, smear = (
            np.interp(at, at[known], v[known], period=len(at)) for v in (shade, doubt, smear)
        )
    return shade, doubt, smear


def _sigma(points: Array, normal: Array, unsure: Array, sides: Sides, spread: float) -> float:
    """Standard deviation of the centre of area along its worse axis, px.

    A rim that moves out by d over the length l at p moves the centre by (p - c) d l / area. A whole side is
    ``unsure`` (n,) px as one; ``spread`` is that of single points.
    """
    after = np.roll(points, -1, axis=0)
    cross = points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1]
    area = 0.5 * float(cross.sum())
    centre = np.sum((points + after) * cross[:, None], axis=0) / (6.0 * area)
    length = 0.5 * np.linalg.norm(after - np.roll(points, 1, axis=0), axis=1)
    pull = (points - centre) * (length / abs(area))[:, None]
    cov = 2.0 * spread**2 * pull.T @ pull
    whole = np.where(sides < 0, _direction(normal), _DIRECTIONS + sides)
    moved = [np.bincount(whole, weights) for weights in (pull * unsure[:, None]).T]
    cov += np.inner(moved, moved)
    return float(np.sqrt(np.linalg.eigvalsh(cov)[-1]))


def _direction(normal: Array) -> NDArray[np.int64]:
    """Which of eight ways each normal (n, 2) points."""
    turn = np.arctan2(normal[:, 1], normal[:, 0]) / (2.0 * np.pi)
    return np.asarray(np.round(turn * _DIRECTIONS), dtype=np.int64) % _DIRECTIONS


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
    return points, normal if median(outward) > 0.0 else -normal


def _corners(normal: Array) -> NDArray[np.bool_]:
    """(n,) where the rim turns within few points: across a corner a side is not as wide as beside it."""
    before, after = np.roll(normal, _CORNER, axis=0), np.roll(normal, -_CORNER, axis=0)
    return np.asarray(np.sum(before * after, axis=1) < _SHARP)


def _steady(colours: Array) -> Array:
    """``colours`` (n, 3) along the rim without what single pixels add."""
    return np.column_stack([_around(colours[:, k], 3.0) for k in range(colours.shape[1])])


def _around(values: Array, sigma: float) -> Array:
    """``values`` (n,) of a closed curve, smoothed by a Gaussian of ``sigma`` points."""
    kernel = _gaussian(sigma)
    reach = len(kernel) // 2
    padded = np.concatenate([values[-reach:], values, values[:reach]])
    out: Array = np.convolve(padded, kernel, mode="valid")
    return out


@cache
def _gaussian(sigma: float) -> Array:
    k = np.arange(-int(3 * sigma) - 1, int(3 * sigma) + 2)
    kernel = np.exp(-0.5 * (k / sigma) ** 2)
    return np.asarray(kernel / kernel.sum())
