"""A UR arm: published or factory-calibrated kinematics behind the ``ArmModel`` Protocol."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from calibration.kinematics.chain import SerialChain
from calibration.kinematics.chain_arm import ChainArm, rows
from calibration.kinematics.inverse import distinct, polish
from calibration.kinematics.ur_inverse import branches
from calibration.kinematics.ur_models import ALPHA, JOINT_LIMITS, UR_MODELS, LinkRadii, UrModel
from cell.arm_model import LinkShape
from cell.poses import Array


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


class UrArmModel(ChainArm):
    """One arm of Universal Robots. ``name`` is a key of ``UR_MODELS``; ``deltas`` None is the drawing.

    ``measured`` is the chain that a tracker found, deltas and all. The metal stays where the drawing has it.
    """

    def __init__(
        self, name: str, deltas: DhDeltas | None = None, measured: SerialChain | None = None
    ) -> None:
        model = UR_MODELS[name]
        nominal = SerialChain(np.zeros(6), model.d, model.a, ALPHA)
        chain = measured or (nominal if deltas is None else _shifted(nominal, deltas))
        super().__init__(name, nominal, chain, JOINT_LIMITS, _link_shapes(model.radii), _reach_after(model))
        self._model = model
        self.calibrated = deltas is not None or measured is not None

    def measured(self, chain: SerialChain) -> "UrArmModel":
        return UrArmModel(self._name, measured=chain)

    def link_ends(self, Q: Array) -> Array:
        """Capsule ends from the *published* lengths.

        Frames 2 and 3 of a calibrated chain can lie hundreds of metres away along parallel axes; the metal
        is where the drawing has it, within a few millimetres.
        """
        model = self._model
        frames = self._frames(self._nominal, rows(Q))
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

    def _branches(self, goal: Array) -> list[Array]:
        """Closed form for the published arm, refined on this one."""
        starts = branches(self._model, goal)
        return distinct(list(polish(self._chain, goal, starts))) if len(starts) else []


def _shifted(nominal: SerialChain, deltas: DhDeltas) -> SerialChain:
    if not any(delta.any() for delta in vars(deltas).values()):
        return nominal
    return SerialChain(
        nominal.theta + deltas.delta_theta,
        nominal.d + deltas.delta_d,
        nominal.a + deltas.delta_a,
        nominal.alpha + deltas.delta_alpha,
    )


def _link_shapes(radii: LinkRadii) -> tuple[LinkShape, ...]:
    """In the order of :meth:`UrArmModel.link_ends`."""
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
