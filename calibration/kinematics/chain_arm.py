"""An arm as a chain of six turning joints: what every model does alike behind the ``ArmModel`` Protocol."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.kinematics.chain import SerialChain, pose_gap
from calibration.kinematics.inverse import converge, nearest_turns, polish
from cell.arm_model import Capsule, LinkShape
from cell.errors import error
from cell.joint_limits import JOINTS
from cell.poses import Array

_ALMOST_M, _ALMOST_RAD = 0.05, 0.3  # joints whose pose is this close may be continued to the goal
_SAME_BRANCH_RAD = 0.1
_SAME_LINE_RAD = 0.5  # between neighbours on a line; more would be another branch


class ChainArm(ABC):
    """``chain`` is in use; ``nominal`` has the metal, and is where the links' capsules are.

    A model says where its links are and which branches reach a pose.
    """

    def __init__(
        self,
        name: str,
        nominal: SerialChain,
        chain: SerialChain,
        limits: Array,
        links: Sequence[LinkShape],
        reach_after: Array,
    ) -> None:
        self._name, self._nominal, self._chain = name, nominal, chain
        self._limits, self._links, self._reach = limits, tuple(links), reach_after
        self._latest: dict[SerialChain, tuple[Array, Array]] = {}  # joints and frames asked for last

    @property
    def name(self) -> str:
        return self._name

    @property
    def chain(self) -> SerialChain:
        """The DH chain in use, factory deltas or what was measured included."""
        return self._chain

    @property
    def joint_limits(self) -> Array:
        return self._limits.copy()

    @property
    def links(self) -> Sequence[LinkShape]:
        return self._links

    @property
    def reach_after(self) -> Array:
        return self._reach.copy()

    def narrowed(self, ranges: Array) -> Self:
        """This arm with its joints within ``ranges`` (6, 2) rad, too; ``DATA_INVALID`` without any room."""
        low = np.maximum(self._limits[:, 0], ranges[:, 0])
        high = np.minimum(self._limits[:, 1], ranges[:, 1])
        for k in np.flatnonzero(low >= high):
            raise error(
                "DATA_INVALID",
                f"joint '{JOINTS[k]}' from {ranges[k, 0]:g} to {ranges[k, 1]:g} rad has nothing in common "
                f"with the range of a {self._name}, {self._limits[k, 0]:.4g} to {self._limits[k, 1]:.4g} "
                "rad; correct limits.joint_ranges_rad or, without it, what the controller allows",
            )
        arm = copy(self)
        arm._limits = np.column_stack([low, high])  # noqa: SLF001 -- of its own class
        return arm

    @abstractmethod
    def measured(self, chain: SerialChain) -> Self:
        """This arm with its flange where ``chain``, as it was measured, has it."""

    @abstractmethod
    def link_ends(self, Q: Array) -> Array: ...

    @abstractmethod
    def _branches(self, goal: Array) -> list[Array]:
        """Joints (6,) of every branch that reaches ``goal`` (4, 4), any of their turns."""

    def forward(self, q: Array) -> RigidTransform:
        return RigidTransform(self._chain.frames(rows(q))[0, -1], normalize=False)

    def forward_many(self, Q: Array) -> RigidTransform:
        return RigidTransform(self.flange_many(Q), normalize=False)

    def flange_many(self, Q: Array) -> Array:
        flange: Array = self._frames(self._chain, rows(Q))[:, -1]
        return flange

    def jacobian(self, q: Array) -> Array:
        J: Array = self.jacobian_many(rows(q))[0]
        return J

    def jacobian_many(self, Q: Array) -> Array:
        return self._chain.jacobians(self._frames(self._chain, rows(Q)))

    def capsules(self, q: Array) -> list[Capsule]:
        ends = self.link_ends(rows(q))[0]
        return [Capsule(p[0], p[1], s.radius_m, s.name) for p, s in zip(ends, self._links, strict=True)]

    def inverse(self, T_base_flange: RigidTransform, q_near: Array) -> Array | None:
        near = np.asarray(q_near, dtype=float)
        goal = T_base_flange.as_matrix()
        continued = self._continue(goal, near)
        if len(continued) and np.max(np.abs(continued[0] - near)) < _SAME_BRANCH_RAD:
            turned = nearest_turns(continued[0], near, self._limits)
            if turned is not None:
                return turned
        found = (nearest_turns(q, near, self._limits) for q in (*continued, *self._branches(goal)))
        candidates = [q for q in found if q is not None]
        return min(candidates, key=lambda q: float(np.linalg.norm(q - near)), default=None)

    def inverse_line(self, T_base_flange: Array, q_near: Array) -> Array | None:
        near = np.asarray(q_near, dtype=float)
        starts = np.broadcast_to(near, (len(T_base_flange), 6))
        together, reached = converge(self._chain, T_base_flange, starts)
        near = starts[0]
        low, high = self._limits.T
        steps = np.diff(together, axis=0, prepend=near[None])
        within = np.all((together >= low) & (together <= high))
        if within and reached.all() and np.abs(steps).max() < _SAME_LINE_RAD:
            return together
        line = []
        for T in T_base_flange:  # one after the other: nothing is nearer to a pose than the one before
            q = self.inverse(RigidTransform.from_matrix(T), near)
            if q is None:
                return None
            line.append(q)
            near = q
        return np.array(line)

    def _frames(self, chain: SerialChain, Q: Array) -> Array:
        """``chain.frames(Q)``, read-only: flange, links and Jacobian are asked for one after the other."""
        latest = self._latest.get(chain)
        if latest is not None and np.array_equal(latest[0], Q):
            return latest[1]
        frames = chain.frames(Q)
        frames.flags.writeable = False
        self._latest[chain] = Q.copy(), frames
        return frames

    def inverse_all(self, T_base_flange: RigidTransform) -> list[Array]:
        found = self._branches(T_base_flange.as_matrix())
        turned = (nearest_turns(q, np.zeros(6), self._limits) for q in found)
        return [q for q in turned if q is not None]

    def _continue(self, goal: Array, near: Array) -> Array:
        """(0 or 1, 6): from joints that almost reach ``goal`` (4, 4).

        Follows a line cheaply, and through poses where the closed form picks an arbitrary wrist angle.
        """
        gap = np.abs(pose_gap(goal[None], self._chain.frames(near[None])[:, -1]))[0]
        if np.max(gap[:3]) > _ALMOST_M or np.max(gap[3:]) > _ALMOST_RAD:
            return np.empty((0, 6))
        return polish(self._chain, goal, near[None])


def rows(q: Array) -> Array:
    """(n, 6) of joints (6,) or (n, 6)."""
    return np.asarray(q, dtype=float).reshape(-1, 6)
