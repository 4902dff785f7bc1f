"""The twin's palletizer in its own terms: a plane linkage that turns about a post, and a wrist that yaws.

A rod from the foot to the wrist makes a parallelogram of upper arm and forearm, so the flange never tips.
Everything then happens in one vertical plane: lengths along it, elevations above the horizon, and two turns
about the vertical. The solver that judges the twin multiplies Denavit-Hartenberg links; the two meet only in
a test.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.poses import Array

JOINTS = 4


@dataclass(frozen=True)
class Palletizer:
    """Lengths (m), offsets (rad) and ratios (link per motor) by their letters.

    ``a1`` post to shoulder and ``d1`` its height, ``a2`` upper arm, ``a3`` forearm, ``a4`` wrist to the yaw
    axis, ``d5`` flange above the wrist, ``a5`` flange off the yaw axis; ``k`` and ``t`` of the four motors.
    """

    a1: float
    a2: float
    a3: float
    a4: float
    a5: float
    d1: float
    d5: float
    k1: float
    k2: float
    k3: float
    k5: float
    t1: float
    t2: float
    t3: float
    t5: float

    @classmethod
    def from_mapping(cls, values: Mapping[str, float]) -> "Palletizer":
        """From a table that has these and perhaps other keys."""
        return cls(**{field.name: float(values[field.name]) for field in fields(cls)})

    def lines(self, q: ArrayLike) -> Array:
        """(5, 2, 3) m: both ends of post, shoulder, upper arm, forearm and wrist in the base, for ``q`` (4,).

        The flange and what it carries are left out, for a reflector sits there.
        """
        q1, q2, q3, _ = np.asarray(q, dtype=float)
        heading, upper = self.k1 * q1 + self.t1, self.k2 * q2 + self.t2
        fore = upper + self.k3 * q3 + self.t3
        steps = [
            (0.0, self.d1),
            (self.a1, 0.0),
            (self.a2 * np.cos(upper), self.a2 * np.sin(upper)),
            (self.a3 * np.cos(fore), self.a3 * np.sin(fore)),
            (self.a4, 0.0),
        ]
        out, up = np.cumsum([(0.0, 0.0), *steps], axis=0).T
        joints = np.column_stack([out * np.cos(heading), out * np.sin(heading), up])
        return np.stack([joints[:-1], joints[1:]], axis=1)

    def flange(self, q: ArrayLike) -> RigidTransform:
        """``T_base_flange`` for motor-side joints ``q`` = [q1, q2, q3, q5], (4,) or (n, 4), rad."""
        return RigidTransform(self.matrix(q), normalize=False, copy=False)

    def matrix(self, q: ArrayLike) -> Array:
        """The same as (4, 4) or (n, 4, 4)."""
        q1, q2, q3, q5 = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
        heading = self.k1 * q1 + self.t1
        upper = self.k2 * q2 + self.t2
        fore = upper + self.k3 * q3 + self.t3
        yaw = heading + self.k5 * q5 + self.t5
        reach = self.a1 + self.a2 * np.cos(upper) + self.a3 * np.cos(fore) + self.a4
        up = self.d1 + self.a2 * np.sin(upper) + self.a3 * np.sin(fore) + self.d5
        x = reach * np.cos(heading) + self.a5 * np.cos(yaw)
        y = reach * np.sin(heading) + self.a5 * np.sin(yaw)
        out = np.zeros((*yaw.shape, 4, 4))
        out[..., 0, 0] = out[..., 1, 1] = np.cos(yaw)
        out[..., 1, 0] = np.sin(yaw)
        out[..., 0, 1] = -out[..., 1, 0]
        out[..., 0, 3], out[..., 1, 3], out[..., 2, 3] = x, y, up
        out[..., 2, 2] = out[..., 3, 3] = 1.0
        return out
