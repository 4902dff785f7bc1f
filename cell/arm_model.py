"""What procedures, the guard and the planner know about an arm's geometry.

The model is pure mathematics: no link to a device, safe to use in any process. Joint angles are radians,
lengths metres, everything in the base frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from cell.poses import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius_m`` of the segment ``p0`` to ``p1`` (3,), m."""

    p0: Array
    p1: Array
    radius_m: float
    name: str


@dataclass(frozen=True)
class LinkShape:
    """The part of a link's capsule that does not depend on the joints.

    ``joints_before`` counts the joints between the base and the link: 0 is bolted down, 1 turns about the
    base axis only.
    """

    name: str
    radius_m: float
    joints_before: int


class ArmModel(Protocol):
    """A six-axis arm: forward and inverse kinematics, and its links as capsules."""

    @property
    def name(self) -> str:
        """Model name, "ur10e"."""
        ...

    @property
    def joint_limits(self) -> Array:
        """(6, 2) rad, lower and upper."""
        ...

    @property
    def links(self) -> Sequence[LinkShape]:
        """The m capsules that stand for the arm, from the base to the flange; no tool."""
        ...

    @property
    def reach_after(self) -> Array:
        """(6,) m: how far from joint i's axis any point of the arm up to the flange can be."""
        ...

    def forward(self, q: Array) -> "RigidTransform":
        """``T_base_flange`` for ``q`` (6,)."""
        ...

    def forward_many(self, Q: Array) -> "RigidTransform":
        """``T_base_flange`` (n) for ``Q`` (n, 6)."""
        ...

    def flange_many(self, Q: Array) -> Array:
        """(n, 4, 4): the matrices of :meth:`forward_many`, not to be written to."""
        ...

    def link_ends(self, Q: Array) -> Array:
        """(n, m, 2, 3): both ends of every capsule for ``Q`` (n, 6)."""
        ...

    def capsules(self, q: Array) -> list[Capsule]:
        """The links as capsules for ``q`` (6,)."""
        ...

    def jacobian(self, q: Array) -> Array:
        """Geometric Jacobian (6, 6) of the flange: velocity (m/s), then angular velocity (rad/s)."""
        ...

    def jacobian_many(self, Q: Array) -> Array:
        """(n, 6, 6): :meth:`jacobian` for ``Q`` (n, 6)."""
        ...

    def inverse(self, T_base_flange: "RigidTransform", q_near: Array) -> Array | None:
        """The joints (6,) within limits that reach the pose and are closest to ``q_near``, or None."""
        ...

    def inverse_line(self, T_base_flange: Array, q_near: Array) -> Array | None:
        """Joints (n, 6) along a line of poses (n, 4, 4), each near the one before, the first ``q_near``
        (6,), or with guesses ``q_near`` (n, 6).

        None where a pose has no joints within limits.
        """
        ...

    def inverse_all(self, T_base_flange: "RigidTransform") -> list[Array]:
        """One solution per branch within limits, each angle as close to zero as its limits let it be."""
        ...
