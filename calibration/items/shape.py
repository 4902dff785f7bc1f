"""Centre, direction and size of a flat outline in space."""

from dataclasses import dataclass

import cv2
import numpy as np

from cell.poses import Array


@dataclass(frozen=True, eq=False)
class Outline:
    """``centre`` (3,) of area, m; ``axis`` (3,) unit vector along the longer side, its sign without meaning;
    ``length`` and ``width`` of the smallest rectangle around it, m."""

    centre: Array
    axis: Array
    length: float
    width: float


def outline(points: Array, normal: Array) -> Outline:
    """Of a closed polygon ``points`` (n, 3) in a plane with unit ``normal`` (3,).

    Moments of a polygon by Green's theorem (Steger, On the calculation of arbitrary moments of polygons,
    1996).
    """
    origin = points.mean(axis=0)
    e1 = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [1.0, 0.0, 0.0])
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(normal, e1)
    x, y = (points - origin) @ e1, (points - origin) @ e2
    x1, y1 = np.roll(x, -1), np.roll(y, -1)
    c = x * y1 - x1 * y
    area = 0.5 * c.sum()
    cx, cy = ((x + x1) * c).sum() / (6.0 * area), ((y + y1) * c).sum() / (6.0 * area)
    xx = ((x * x + x * x1 + x1 * x1) * c).sum() / (12.0 * area) - cx * cx
    yy = ((y * y + y * y1 + y1 * y1) * c).sum() / (12.0 * area) - cy * cy
    xy = ((x * y1 + 2.0 * x * y + 2.0 * x1 * y1 + x1 * y) * c).sum() / (24.0 * area) - cx * cy
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    _, (a, b), _ = cv2.minAreaRect(np.column_stack([x, y]).astype(np.float32) * 1000.0)
    return Outline(
        origin + cx * e1 + cy * e2,
        np.cos(angle) * e1 + np.sin(angle) * e2,
        max(a, b) / 1000.0,
        min(a, b) / 1000.0,
    )
