"""The arm of a twin as it truly stands, from the truth that the twin tells."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.kinematics.families import arm_spec
from calibration.kinematics.joint_errors import JointErrors
from cell.formats.robot import parse_robot
from cell.poses import Array


def true_links(robot: Mapping[str, Any]) -> dict[str, Any]:
    """The ROBOT with the links of ``robot`` of a twin's truth; :func:`actual_joints` has its joints."""
    deltas = {
        key: (np.array(robot["factory"][key]) + np.array(robot["error"][key])).tolist()
        for key in robot["error"]
    }
    return {"model": robot["model"], "calibration": deltas}


def actual_joints(robot: Mapping[str, Any], Q: Array) -> Array:
    """(n, j) rad: where the joints of the twin's arm are when they read ``Q`` (n, j)."""
    waves = robot["joint_errors"]
    joint, of, sin, cos = (np.array([wave[key] for wave in waves]) for key in ("joint", "of", "sin", "cos"))
    names = tuple(wave["name"] for wave in waves)
    return JointErrors(names, joint.astype(np.int64) - 1, of.reshape(-1, Q.shape[1]), sin, cos).actual(Q)


def true_flange(robot: Mapping[str, Any], Q: Array) -> Array:
    """T_base_flange (n, 4, 4) of the twin's arm when its joints read ``Q`` (n, j)."""
    links = arm_spec(parse_robot(true_links(robot), "robot of the twin's truth")).arm
    out: Array = links.base.flange(actual_joints(robot, Q))
    return out


def observed_flange(observed: Mapping[str, Any], Q: Array) -> Array:
    """T_base_flange (n, 4, 4) of the twin's arm that is only read when its joints read ``Q`` (n, j)."""
    robot = observed["robot"]
    true = robot | {"parameters": robot["parameters"] | observed["parameters"]}
    true["joint_errors"] = observed["joint_errors"]
    out: Array = arm_spec(parse_robot(true, "observed arm of the twin's truth")).arm.base.flange(Q)
    return out
