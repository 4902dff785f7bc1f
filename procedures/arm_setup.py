"""From the values of a run to its arm: the model in use, and what a motion lease needs."""

import json
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from calibration.kinematics import measured_arm, robot_from_spec
from cell.arm_model import ArmModel
from cell.devices import Speed, ToolSettings
from cell.errors import error
from cell.guard import GuardLimits, MotionGuard, Tool
from cell.joint_limits import limit_words, per_joint
from cell.modelled_arm import ArmModels
from cell.poses import from_pose6
from cell.run_values import RunValues
from procedures.kinematics_in_use import in_use


def arm_model(values: RunValues) -> ArmModel:
    """The arm as this run takes it to be: what turns its joints into poses and wanted poses into joints."""
    measured = in_use(values)
    if measured is None:
        return believed_arm(values)
    return _measured(*(json.dumps(part) for part in (values.robot, measured, _joint_ranges(values))))


@lru_cache(maxsize=2)
def _measured(believed: str, measured: str, joint_ranges: str) -> ArmModel:
    """Kept: jobs ask again and again, on the loop."""
    return measured_arm(json.loads(believed), json.loads(measured), json.loads(joint_ranges))


def believed_arm(values: RunValues) -> ArmModel:
    """The arm as its controller believes it to be, within the joint ranges of ``[limits]``."""
    return robot_from_spec(values.robot, _joint_ranges(values))


def _joint_ranges(values: RunValues) -> Any:
    """None in what was recorded before there was such a limit."""
    return values.limits.get("joint_ranges_rad")


def arm_robot(values: RunValues) -> dict[str, Any]:
    """The ROBOT of :func:`arm_model`, for a data set whose poses come from it."""
    return dict(in_use(values) or values.robot)


def arm_models(values: RunValues) -> ArmModels | None:
    """What the arm is and what its controller believes; None where the run believes the controller."""
    if in_use(values) is None:
        return None
    return ArmModels(arm_model(values), believed_arm(values))


def lease_settings(values: RunValues) -> tuple[MotionGuard, ToolSettings, Speed]:
    """Guard, tool and speed for a lease, from the values resolved at the run's start."""
    limits, tool = values.limits, values.tool
    guard = MotionGuard(arm_model(values), GuardLimits.from_mapping(limits), Tool.from_mapping(tool))
    x, y, z = values.centre_of_mass_m
    settings = ToolSettings(from_pose6(tool["T_flange_tool"]), values.payload_kg, (x, y, z))
    joints = per_joint(limits["joint_speed_rad_s"])
    speed = Speed(
        limits["speed_m_s"],
        limits["accel_m_s2"],
        float(joints.max()),
        limits["joint_accel_rad_s2"],
        tuple(joints.tolist()),
    )
    return guard, settings, speed


def with_job_limits(values: RunValues, wanted: Any) -> RunValues:
    """The values of a job that brings ``limits`` of its own: lower ones always hold, higher ones where
    ``[limits] allow_job_override`` allows it, else ``ARGUMENT_INVALID``."""
    if wanted is None:
        return values
    limits = dict(values.limits)
    for key, value in wanted.model_dump().items():
        if key not in limits:
            continue
        if np.any(np.greater(value, limits[key])) and not limits["allow_job_override"]:
            raise error(
                "ARGUMENT_INVALID",
                f"limits.{key} {limit_words(value)} is above {limit_words(limits[key])} of [limits]; lower "
                "it, or set allow_job_override there",
            )
        limits[key] = value
    return replace(values, limits=limits)
