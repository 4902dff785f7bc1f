"""A UR arm: published or factory-calibrated kinematics behind the ``ArmModel`` Protocol."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.kinematics.chain import DhChain, pose_gap
from calibration.kinematics.inverse import converge, distinct, nearest_turns, polish
from calibration.kinematics.ur_inverse import branches
from calibration.kinematics.ur_models import ALPHA, JOINT_LIMITS, UR_MODELS, LinkRadii, UrModel
from cell.arm_model import Capsule, LinkShape
from cell.poses import Array

_ALMOST_M, _ALMOST_RAD = 0.05, 0.3  # joints whose pose is this close may be continued to the goal
_SAME_BRANCH_RAD = 0.1
_SAME_LINE_RAD = 0.5  # between neighbours on a line; more would be another branch


def _zeros() -> Array:
    return np.zeros(6)


@dataclass(frozen=True, eq=False)
class DhDeltas:
    """What a factory calibration adds to the published DH table, (6,) each, rad and m.

    ``delta_d`` of joints 2 and 3 may be hundreds of metres of opposite sign: their axes are almost parallel,
    so the common normal can lie anywhere along them. Magnitudes say nothing about validity.
    """

    delta_theta: Array = field(default_factory=_zeros)
    delta_d: Array = field(default_factory=_zeros)
    delta_a: Array = field(default_factory=_zeros)
    delta_alpha: Array = field(default_factory=_zeros)


class UrArm:
    """One arm of Universal Robots. ``name`` is a key of ``UR_MODELS``; ``deltas`` None is the drawing.

    ``measured`` is the chain that a tracker found, deltas and all. The metal stays where the drawing has it.
    """

    def __init__(self, name: str, deltas: DhDeltas | None = None, measured: DhChain | None = None) -> None:
        model = UR_MODELS[name]
        self._name, self._model = name, model
        self._nominal = DhChain(np.zeros(6), model.d, model.a, ALPHA)
        self.calibrated = deltas is not None or measured is not None
        self._chain = measured or (self._nominal if deltas is None else _shifted(self._nominal, deltas))
        self._links = _link_shapes(model.radii)
        self._reach = _reach_after(model)

    @property
    def name(self) -> str:
        return self._name

    @property
    def chain(self) -> DhChain:
        """The DH chain in use, factory deltas or what was measured included."""
        return self._chain

    @property
    def joint_limits(self) -> Array:
        return JOINT_LIMITS.copy()

    @property
    def links(self) -> Sequence[LinkShape]:
        return self._links

    @property
    def reach_after(self) -> Array:
        return self._reach.copy()

    def forward(self, q: Array) -> RigidTransform:
        return RigidTransform(self._chain.frames(_rows(q))[0, -1], normalize=False)

    def forward_many(self, Q: Array) -> RigidTransform:
        return RigidTransform(self._chain.frames(_rows(Q))[:, -1], normalize=False)

    def jacobian(self, q: Array) -> Array:
        J: Array = self.jacobian_many(_rows(q))[0]
        return J

    def jacobian_many(self, Q: Array) -> Array:
        return self._chain.jacobians(self._chain.frames(_rows(Q)))

    def link_ends(self, Q: Array) -> Array:
        """Capsule ends from the *published* lengths.

        Frames 2 and 3 of a calibrated chain can lie hundreds of metres away along parallel axes; the metal
        is where the drawing has it, within a few millimetres.
        """
        model = self._model
        frames = self._nominal.frames(_rows(Q))
        origin, z1 = frames[..., :3, 3], frames[:, 1, :3, 2]
        upper, fore = model.shoulder_offset * z1, model.elbow_offset * z1
        points = [
            origin[:, 0],
            origin[:, 1],
            origin[:, 1] + upper,
            origin[:, 2] + upper,
            origin[:, 2] + fore,
            origin[:, 3] + fore,
            origin[:, 4],
            origin[:, 5],
            origin[:, 6],
        ]
        return np.stack([np.stack(pair, axis=1) for pair in pairwise(points)], axis=1)

    def capsules(self, q: Array) -> list[Capsule]:
        ends = self.link_ends(_rows(q))[0]
        return [Capsule(p[0], p[1], s.radius_m, s.name) for p, s in zip(ends, self._links, strict=True)]

    def inverse(self, T_base_flange: RigidTransform, q_near: Array) -> Array | None:
        near = np.asarray(q_near, dtype=float)
        goal = T_base_flange.as_matrix()
        continued = self._continue(goal, near)
        if len(continued) and np.max(np.abs(continued[0] - near)) < _SAME_BRANCH_RAD:
            turned = nearest_turns(continued[0], near, JOINT_LIMITS)
            if turned is not None:
                return turned
        found = (nearest_turns(q, near, JOINT_LIMITS) for q in (*continued, *self._branches(goal)))
        candidates = [q for q in found if q is not None]
        return min(candidates, key=lambda q: float(np.linalg.norm(q - near)), default=None)

    def inverse_line(self, T_base_flange: Array, q_near: Array) -> Array | None:
        near = np.asarray(q_near, dtype=float)
        starts = np.broadcast_to(near, (len(T_base_flange), 6))
        together, reached = converge(self._chain, T_base_flange, starts)
        near = starts[0]
        low, high = JOINT_LIMITS.T
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

    def inverse_all(self, T_base_flange: RigidTransform) -> list[Array]:
        found = self._branches(T_base_flange.as_matrix())
        turned = (nearest_turns(q, np.zeros(6), JOINT_LIMITS) for q in found)
        return [q for q in turned if q is not None]

    def _continue(self, goal: Array, near: Array) -> Array:
        """(0 or 1, 6): from joints that almost reach ``goal`` (4, 4).

        Follows a line cheaply, and through poses where the closed form picks an arbitrary wrist angle.
        """
        gap = np.abs(pose_gap(goal[None], self._chain.frames(near[None])[:, -1]))[0]
        if np.max(gap[:3]) > _ALMOST_M or np.max(gap[3:]) > _ALMOST_RAD:
            return np.empty((0, 6))
        return polish(self._chain, goal, near[None])

    def _branches(self, goal: Array) -> list[Array]:
        """Closed form for the published arm, refined on this one."""
        starts = branches(self._model, goal)
        return distinct(list(polish(self._chain, goal, starts))) if len(starts) else []


def _rows(q: Array) -> Array:
    return np.asarray(q, dtype=float).reshape(-1, 6)


def _shifted(nominal: DhChain, deltas: DhDeltas) -> DhChain:
    return DhChain(
        nominal.theta + deltas.delta_theta,
        nominal.d + deltas.delta_d,
        nominal.a + deltas.delta_a,
        nominal.alpha + deltas.delta_alpha,
    )


def _link_shapes(radii: LinkRadii) -> tuple[LinkShape, ...]:
    """In the order of :meth:`UrArm.link_ends`."""
    return (
        LinkShape("base", radii.base, 0),
        LinkShape("shoulder", radii.shoulder, 1),
        LinkShape("upper arm", radii.upper_arm, 2),
        LinkShape("elbow", radii.upper_arm, 2),
        LinkShape("forearm", radii.forearm, 3),
        LinkShape("wrist 1", radii.wrist, 3),
        LinkShape("wrist 2", radii.wrist, 4),
        LinkShape("wrist 3", radii.wrist, 5),
    )


def _reach_after(model: UrModel) -> Array:
    """(6,) m: an upper bound, the sum of the lengths that follow each joint."""
    wrist3 = abs(model.d6)
    wrist2 = wrist3 + abs(model.d5)
    wrist1 = wrist2 + abs(model.d4)
    elbow = wrist1 + abs(model.a3) + abs(model.elbow_offset)
    shoulder = elbow + abs(model.a2) + abs(model.shoulder_offset)
    return np.array([shoulder, shoulder, elbow, wrist1, wrist2, wrist3])
