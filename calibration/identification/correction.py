"""What to command so that the true flange gets where it is wanted: for jobs that move a calibrated arm.

A controller turns a wanted pose into joints by the model that *it* believes. The calibrated model says which
joints really lead there, and the believed one which pose the controller takes for those joints: that pose is
the one to command. With joint moves the joints alone are enough.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.identification.application import reach
from calibration.kinematics.families import arm_spec
from calibration.kinematics.serial import SerialChain
from cell.errors import error
from cell.formats.robot import parse_robot
from cell.poses import Array


@dataclass(frozen=True, eq=False)
class Correction:
    """``q`` (j,) rad are the joints at which the calibrated flange has the wanted pose; ``T_base_flange`` is
    what a controller that believes its own model has to be told, ``shift_m`` and ``turn_rad`` how far that is
    from what was wanted."""

    q: Array
    T_base_flange: RigidTransform
    shift_m: float
    turn_rad: float


def chain_of(robot: Mapping[str, Any]) -> SerialChain:
    """The chain of a ROBOT: the ``robot`` of ``kinematics.<device>``, or what a controller believes."""
    return arm_spec(parse_robot(robot, "robot")).arm.base


def corrected_flange_target(
    T_wanted: RigidTransform, q_near: Array, calibrated: SerialChain, controller: SerialChain
) -> Correction:
    """The target to command for the true flange to get to ``T_wanted`` (in the base).

    ``q_near`` (j,) picks the branch, as the controller's own inverse would. ``calibrated`` and ``controller``
    come from :func:`chain_of`. A job finds the first in ``run.values["kinematics"]["arm"]["robot"]`` (None
    while nothing is committed) and the second in ``run.values["robot"]``. ``MOTION_UNREACHABLE`` when the
    calibrated arm cannot get there from ``q_near``.

    The base of a calibrated arm is known as far as the readings tell it: what they cannot tell apart from the
    tracker's place is as the drawing has it. Absolute places need ``T_base_tracker`` of the same calibration.
    """
    near = np.asarray(q_near, dtype=float)
    found = reach(calibrated, T_wanted.as_matrix()[None], near[None], near[None], level=False)
    if not found.found[0]:
        where = ", ".join(f"{v:.3f}" for v in T_wanted.translation)
        raise error(
            "MOTION_UNREACHABLE",
            f"the calibrated arm stays {1e3 * found.miss[0]:.2f} mm (or mrad) off the pose at {where} m",
        )
    q = found.q[0]
    told = RigidTransform.from_matrix(controller.flange(q[None])[0])
    apart = T_wanted.inv() * told
    return Correction(
        q=q,
        T_base_flange=told,
        shift_m=float(np.linalg.norm(apart.translation)),
        turn_rad=float(apart.rotation.magnitude()),
    )
