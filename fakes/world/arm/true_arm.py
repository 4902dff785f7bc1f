"""The arm as it truly stands at what its encoders read."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.poses import Array
from fakes.world.arm.joint_errors import JointErrors, joint_errors
from fakes.world.arm.kinematics import Chain, chain_of
from fakes.world.arm.truth import ArmTruth

_TOOL_M = 1.0  # no tool reaches further than that


class TrueArm:
    """``links`` at ``errors.actual(q)``; the joints ``q`` of all methods are as read, rad."""

    def __init__(self, links: Chain, errors: JointErrors | None = None) -> None:
        self.links, self.errors = links, errors

    @property
    def screws(self) -> Array:
        """The joints' axes (6, 6) with all joints at zero, as :class:`Chain` has them."""
        return self.links.screws

    def matrix(self, q: ArrayLike) -> Array:
        """``T_base_flange`` as a 4x4 matrix for ``q`` (6,), or (n, 4, 4) for (n, 6)."""
        return self.links.matrix(self._actual(q))

    def forward(self, q: ArrayLike) -> RigidTransform:
        """``T_base_flange`` for ``q`` (6,) or (n, 6)."""
        return self.links.forward(self._actual(q))

    def partial(self, q: ArrayLike) -> Array:
        """What the first 0, 1, ... 6 joints at ``q`` (6,) do to points that they carry: (7, 4, 4)."""
        return self.links.partial(self._actual(q))

    def levers(self) -> Array:
        """Upper bounds (6,), m, of how far the flange goes for a radian of each joint as read."""
        levers = self.links.levers()
        if self.errors is None:
            return levers
        # A joint that gives way may do so because another one has turned.
        out: Array = levers + self.errors.steepest * (levers.max() + _TOOL_M)
        return out

    @classmethod
    def of(cls, truth: ArmTruth, seed: int) -> Self:
        """The arm of a scenario, whose waves of the gears are drawn by ``seed``."""
        links = chain_of(*truth.drawing(truth.factory.deltas() + truth.error.deltas()))
        return cls(links, joint_errors(truth.joint_errors, links, seed))

    def _actual(self, q: ArrayLike) -> Array:
        q = np.asarray(q, dtype=float)
        return q if self.errors is None else self.errors.actual(q)
