"""The arm of a capture: its model and the joints of every observation, when the set has both."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.kinematics.families import ArmSpec, arm_spec
from cell.errors import error
from cell.formats.robot import parse_robot
from cell.poses import Array
from procedures.hand_eye.solve.capture import CaptureSet
from procedures.hand_eye.solve.joints_check import check_joints

JOINTS = 6


@dataclass(frozen=True)
class GivenArm:
    """``spec`` and the joints ``Q`` (n, 6) of n observations, rad; their flange poses are the arm's."""

    spec: ArmSpec
    Q: Array


def given_arm(loaded: CaptureSet, rows: NDArray[np.int64]) -> tuple[GivenArm | None, str]:
    """The arm at the observations ``rows``; or None, and why its errors cannot be unknowns.

    ``InputError`` where the flange's poses are not those of robot at the joints.
    """
    given = loaded.capture.robot
    if given is None:
        return None, "the data set has no robot"
    spec = arm_spec(parse_robot(given, "robot"), "robot")
    joints = [loaded.capture.observations[int(row)].q for row in rows]
    known = [q for q in joints if q is not None]
    if len(known) < len(joints):
        return None, "the data set has no q of every observation"
    if spec.arm.joints != JOINTS:
        return None, f"robot has {spec.arm.joints} joints, and errors of arms with {JOINTS} are known"
    _check_lengths(loaded, rows, known)
    Q = np.array(known, dtype=float)
    check_joints(loaded, rows, spec.arm, Q)
    return GivenArm(spec, Q), ""


def _check_lengths(loaded: CaptureSet, rows: NDArray[np.int64], joints: Sequence[Sequence[float]]) -> None:
    for row, q in zip(rows, joints, strict=True):
        if len(q) != JOINTS:
            raise error(
                "DATA_INVALID",
                f"{loaded.path}: observation {loaded.indices[int(row)]}: q has {len(q)} numbers, and robot "
                f"has {JOINTS} joints",
            )
