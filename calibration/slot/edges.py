"""The sides of a rectangle in colour: where it is in the picture, and each side to a part of a pixel.

No polarity is assumed: an opening is darker than the plate around it, a part may be lighter or of another
colour. An edge is found from the area under the profile across it, so blur of the lens does not move it.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_STEP = 0.25  # px along a profile
PROFILE_PX = 7.0  # to either side of where the edge is expected
LEVEL_PX = 3.0  # px from the edge on, where the levels of both sides are read
_LEAST_CONTRAST = 15.0  # grey levels
_OFF = 4.0  # robust standard deviations: an edge point that lies farther off belongs to something else
_FLOOR_PX = 0.02
_COARSE_PX = 2  # between two places that are tried
_BLUR_PX = 1.5


@dataclass(frozen=True)
class SideEdges:
    """Of each side (4,): whether its edge is seen, its contrast (grey levels), and of each point (4, n) how
    far out of the rim the edge lies (px) and whether it is used."""

    seen: NDArray[np.bool_]
    contrast: Array
    off_px: Array
    used: NDArray[np.bool_]


def coarse_shift(
    colour: NDArray[np.float32], rim: Array, outward: Array, reach_px: Array
) -> tuple[Array, float]:
    """The shift (2,) px of ``rim`` (4, n, 2), at most ``reach_px`` (2,), at which its four sides lie on edges
    best, and the weakest side's edge there (grey levels/px)."""
    shifts = [np.arange(-r, r + _COARSE_PX, _COARSE_PX) for r in np.maximum(reach_px, _COARSE_PX)]
    sx, sy = (g.ravel() for g in np.meshgrid(*shifts))
    smooth = cv2.GaussianBlur(colour, (0, 0), _BLUR_PX)
    best = np.full(len(sx), np.inf)
    total = np.zeros(len(sx))
    for side in range(4):
        middle = outward[side].mean(axis=0)
        gradient = _derivative(smooth, middle)  # (h, w, 3)
        some = slice(None, None, 4)
        u, v = (rim[side, some, k][None] + s[:, None] for k, s in ((0, sx), (1, sy)))
        seen = cv2.remap(
            gradient, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderValue=(0, 0, 0)
        )
        strength = np.linalg.norm(seen.mean(axis=1), axis=1)  # an edge has one sign all along
        best, total = np.minimum(best, strength), total + strength
    k = int(np.argmax(best + 0.25 * total))
    return np.array([sx[k], sy[k]]), float(best[k])


def side_edges(
    colour: NDArray[np.float32], rim: Array, outward: Array, profile_px: float = PROFILE_PX
) -> SideEdges:
    """Every side's edge near ``rim`` (4, n, 2) px along ``outward`` (4, n, 2), by profiles ``profile_px`` to
    either side, in which there is no other edge."""
    s = np.arange(-profile_px, profile_px + 1e-9, _STEP)
    where = (rim[:, :, None] + s[None, None, :, None] * outward[:, :, None]).astype(np.float32)
    flat = where.reshape(-1, len(s), 2)
    seen = cv2.remap(
        colour,
        flat[..., 0],
        flat[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).reshape(*where.shape[:3], 3)
    off, contrast = np.zeros(rim.shape[:2]), np.zeros(4)
    used = np.zeros(rim.shape[:2], dtype=bool)
    for side in range(4):
        off[side], contrast[side] = _located(s, seen[side])
        used[side] = _agreeing(off[side])
    visible = (contrast > _LEAST_CONTRAST) & (used.mean(axis=1) > 0.5)
    return SideEdges(visible, contrast, off, used & visible[:, None])


def _derivative(smooth: NDArray[Any], way: Array) -> NDArray[np.float32]:
    gx, gy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3) / 8.0 for order in ((1, 0), (0, 1)))
    return np.asarray(way[0] * gx + way[1] * gy, dtype=np.float32)


def _located(s: Array, seen: Array) -> tuple[Array, float]:
    """Where the edge of each profile ``seen`` (n, k, 3) lies (n,) along ``s`` (k,), and the contrast."""
    inside = np.median(seen[:, s <= -LEVEL_PX].reshape(-1, 3), axis=0)
    outside = np.median(seen[:, s >= LEVEL_PX].reshape(-1, 3), axis=0)
    way = outside - inside
    contrast = float(np.linalg.norm(way))
    if contrast < 1.0:
        return np.zeros(len(seen)), contrast
    rise = (seen - inside) @ (way / contrast**2)  # 0 inside, 1 outside
    low = rise[:, s <= -LEVEL_PX].mean(axis=1)
    high = rise[:, s >= LEVEL_PX].mean(axis=1)
    rise = (rise - low[:, None]) / np.maximum(high - low, 0.2)[:, None]
    area = np.trapezoid(np.clip(rise, -0.5, 1.5), s, axis=1)
    return np.asarray(s[-1] - area), contrast


def _agreeing(off: Array) -> NDArray[np.bool_]:
    """Points that lie on one line with most of their side."""
    x = np.linspace(-1.0, 1.0, len(off))
    keep = np.ones(len(off), dtype=bool)
    for _ in range(3):
        line = np.polynomial.Polynomial.fit(x[keep], off[keep], 1)
        left = off - line(x)
        spread = 1.4826 * float(np.median(np.abs(left[keep]))) + _FLOOR_PX
        keep = np.abs(left) < _OFF * spread
    return keep
