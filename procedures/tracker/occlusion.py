"""What of an arm can stand in a tracker's beam: its links as capsules.

An arm that we move has the shape that its motion guard goes by, a UR that is only observed its maker's
drawings. Of other chains only the lengths are known: their links are drawn along ``d`` and ``a`` of every row
with one radius, which has to be given, for a table need not follow the castings.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.kinematics import UR_MODELS, UrArmModel
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import ArmSpec
from cell.formats.robot import NamedRobot
from cell.guard import MotionGuard
from cell.poses import Array

_POINT_M = 1e-6  # shorter pieces of a chain are none


@dataclass(frozen=True, eq=False)
class Shape:
    """Capsules with ``radii`` (k,) m; ``ends`` takes joints (n, j) to both ends (n, k, 2, 3), m, base."""

    radii: Array
    ends: Callable[[Array], Array]


def shape_of(spec: ArmSpec, guard: MotionGuard | None, radius_m: float | None) -> Shape | None:
    """The shape of an arm, moved under ``guard`` or observed; None where nothing is known of it."""
    if guard is not None:
        return Shape(guard.radii, guard.capsule_ends)
    if isinstance(spec.robot, NamedRobot) and spec.robot.model in UR_MODELS:
        arm = UrArmModel(spec.robot.model)
        return Shape(np.array([link.radius_m for link in arm.links]), arm.link_ends)
    if radius_m is None:
        return None
    rows = _lines(spec.arm.base, np.zeros((1, spec.arm.joints)))
    there = np.linalg.norm(rows[0, :, 1] - rows[0, :, 0], axis=1) > _POINT_M
    return Shape(np.full(int(there.sum()), radius_m), lambda Q: _lines(spec.arm.base, Q)[:, there])


def _lines(chain: SerialChain, Q: Array) -> Array:
    """(n, 2 m, 2, 3): along z by ``d``, then along x by ``a``, link by link."""
    walk = chain.walk(Q)
    o = walk.o.transpose(2, 0, 1)
    corner = (walk.o[1:] - chain.a[:, None, None] * walk.turned).transpose(2, 0, 1)
    up, along = np.stack([o[:, :-1], corner], axis=2), np.stack([corner, o[:, 1:]], axis=2)
    return np.concatenate([up, along], axis=1)
