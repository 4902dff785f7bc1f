"""A target as it was printed and mounted: too large or too small, and bowed.

``x`` and ``y`` of the design are stretched from the target's origin. The bow is that of a sheet bent one way:
z grows with the square of the distance from the line through the pattern's middle, to ``bow_m`` at the point
of the pattern that is farthest from it. The sheet itself is so little shorter for that (a millionth at 0.2 mm
in 0.2 m) that x and y stay.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cell.poses import Array
from fakes.world.camera.truth import PrintTruth
from fakes.world.targets import target_points


@dataclass(frozen=True, eq=False)
class Printed:
    """``stretch`` (3,) are factors of the design's coordinates. In the target's frame the print's z is
    ``bend (across . (p - middle))^2``: ``bend`` in 1/m, ``across`` (3,) of length 1 and ``middle`` (3,) m."""

    stretch: Array = field(default_factory=lambda: np.ones(3))
    bend: float = 0.0
    across: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    middle: Array = field(default_factory=lambda: np.zeros(3))

    def placed(self, points: Array) -> Array:
        """Where points (n, 3) of the design truly are, m, in the target's frame."""
        return self.bowed(points * self.stretch)

    def bowed(self, points: Array) -> Array:
        """Points (n, 3) of the flat print, m, on the bowed one."""
        off = (points - self.middle) @ self.across
        return np.column_stack([points[:, :2], points[:, 2] + self.bend * off * off])

    def reach(self, origin: Array, rays: Array) -> Array:
        """How many times ``rays`` (..., 3) lead from ``origin`` (3,) m, in the target's frame, to the print.

        A ray that misses the cylinder gets what is nearest; that is far outside the target.
        """
        way, start = rays @ self.across, float((origin - self.middle) @ self.across)
        # bend (start + k way)^2 = origin_z + k ray_z, by the root that stays when the bend goes to zero
        a, c = self.bend * way * way, self.bend * start * start - origin[2]
        b = 2.0 * self.bend * start * way - rays[..., 2]
        root = np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0))
        out: Array = -2.0 * c / (b + np.copysign(root, b))
        return out


def printed_target(truth: PrintTruth, target: Mapping[str, Any]) -> Printed:
    """The print of ``target`` that a scenario describes."""
    stretch = np.array([1.0 + truth.scale_x, 1.0 + truth.scale_y, 1.0])
    if truth.bow_m == 0.0:
        return Printed(stretch)
    points = target_points(dict(target)) * stretch
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    across = np.array([np.cos(truth.bow_rad), np.sin(truth.bow_rad), 0.0])
    edge = float(np.abs((points - middle) @ across).max())
    return Printed(stretch, truth.bow_m / edge**2, across, middle)
