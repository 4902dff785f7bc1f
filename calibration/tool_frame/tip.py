"""How much lower the end of a tilted tool reaches than its point: it depends on the shape of the end.

A flat end reaches lower by its radius times the tilt (60 um at 3 mm and 20 mrad), a ball does not. Passes
that just met the tool tell which it is: at a depth ``d`` below the first contact a ball is ``2 sqrt(2 r d)``
wide, a tilted flat end begins with a corner, and an end that counts as a point is as wide as the tool at
once. Each shape is weighed by how well it explains the widths that were seen; what they leave open widens
the answer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cell.poses import Array

SHAPES = {"point": 0.3, "ball": 0.3, "edge": 0.1, "flat": 0.3}
_CAP = 25.0
_RIM = np.linspace(0.0, 2.0 * np.pi, 361)


@dataclass(frozen=True, eq=False)
class View:
    """The tool as one beam sees it in one set.

    ``axis`` (3,) is in the base from the flange to the point, ``n`` (3,) normal to beam and axis, ``lift``
    and ``side`` (3,) are up and along the pass, both normal to the beam.
    """

    axis: Array
    n: Array
    lift: Array
    side: Array
    radius: float

    def bulge(self, shape: str) -> float:
        """How much lower (m, along ``lift``) the end reaches than its middle, against the tool upright."""
        if shape == "edge":
            return self.radius * abs(float(self.lift @ self.n))
        if shape == "flat":
            return self.radius * float(np.sqrt(max(1.0 - float(self.lift @ self.axis) ** 2, 0.0)))
        return 0.0

    def width(self, shape: str, depth: float) -> float:
        """How wide (m) the tool is at ``depth`` below the first contact."""
        r, full = self.radius, 2.0 * self.radius
        d = max(depth, 0.0)
        if shape == "ball":
            return full if d >= r else 2.0 * float(np.sqrt(d * (2.0 * r - d)))
        if shape == "edge":
            lean = abs(float(self.lift @ self.n))
            return full if d >= full * lean else d / lean
        if shape == "flat":
            e1 = np.cross(self.axis, self.lift)
            if float(np.linalg.norm(e1)) < 1e-6:
                return full
            e1 = e1 / np.linalg.norm(e1)
            e2 = np.cross(self.axis, e1)
            rim = r * (np.cos(_RIM)[:, None] * e1 + np.sin(_RIM)[:, None] * e2)
            up, along = rim @ self.lift, rim @ self.side
            inside = along[up - np.min(up) <= d]
            return float(np.ptp(inside)) if len(inside) else 0.0
        return full


@dataclass(frozen=True, eq=False)
class Touch:
    """A pass that met the tool ``depth`` (m) below the first contact, known to ``sigma_depth``, and saw it
    ``width`` (m) wide, known to ``sigma``."""

    view: View
    depth: float
    sigma_depth: float
    width: float
    sigma: float


def weigh(touches: Sequence[Touch]) -> dict[str, float]:
    """How likely each shape is after all passes near the tool's end."""
    log = {shape: float(np.log(prior)) for shape, prior in SHAPES.items()}
    for touch in touches:
        for shape in SHAPES:
            near = [touch.view.width(shape, touch.depth + s * touch.sigma_depth) for s in (-1.0, 0.0, 1.0)]
            sigma = float(np.hypot(touch.sigma, 0.5 * (max(near) - min(near))))
            log[shape] -= 0.5 * min(((touch.width - near[1]) / sigma) ** 2, _CAP)
    top = max(log.values())
    weight = {shape: float(np.exp(v - top)) for shape, v in log.items()}
    total = sum(weight.values())
    return {shape: w / total for shape, w in weight.items()}


def bulge_change(before: View, now: View, weights: Mapping[str, float]) -> tuple[float, float]:
    """How much lower the end reaches now than in the reference (m), with its standard deviation."""
    change = np.array([now.bulge(s) - before.bulge(s) for s in weights])
    w = np.array(list(weights.values()))
    mean = float(w @ change)
    return mean, float(np.sqrt(max(float(w @ (change - mean) ** 2), 0.0)))
