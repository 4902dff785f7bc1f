"""From the values of a run to its arm: the model in use, and what a motion lease needs."""

import json
from dataclasses import replace
from functools import lru_cache
from typing import Any

from calibration.kinematics import measured_arm, robot_from_spec
from cell.arm_model import ArmModel
from cell.devices import Speed, ToolSettings
from cell.errors import error
from cell.guard import GuardLimits, MotionGuard, Tool
from cell.modelled_arm import ArmModels
from cell.poses import from_pose6
from cell.run_values import RunValues
from procedures.kinematics_in_use import in_use


def arm_model(values: RunValues) -> ArmModel:
    """The arm as this run takes it to be: what turns its joints into poses and wanted poses into joints."""
    measured = in_use(values)
    if measured is None:
        return robot_from_spec(values.robot)
    return _measured(json.dumps(values.robot), json.dumps(measured))


@lru_cache(maxsize=2)
def _measured(believed: str, measured: str) -> ArmModel:
    """Kept: jobs ask again and again, on the loop."""
    return measured_arm(json.loads(believed), json.loads(measured))


def arm_robot(values: RunValues) -> dict[str, Any]:
    """The ROBOT of :func:`arm_model`, for a data set whose poses come from it."""
    return dict(in_use(values) or values.robot)


def arm_models(values: RunValues) -> ArmModels | None:
    """What the arm is and what its controller believes; None where the run believes the controller."""
    if in_use(values) is None:
        return None
    return ArmModels(arm_model(values), robot_from_spec(values.robot))


def lease_settings(values: RunValues) -> tuple[MotionGuard, ToolSettings, Speed]:
    """Guard, tool and speed for a lease, from the values resolved at the run's start."""
    limits, tool = values.limits, values.tool
    guard = MotionGuard(arm_model(values), GuardLimits.from_mapping(limits), Tool.from_mapping(tool))
    x, y, z = values.centre_of_mass_m
    settings = ToolSettings(from_pose6(tool["T_flange_tool"]), values.payload_kg, (x, y, z))
    speed = Speed(
        limits["speed_m_s"], limits["accel_m_s2"], limits["joint_speed_rad_s"], limits["joint_accel_rad_s2"]
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
        if value > limits[key] and not limits["allow_job_override"]:
            raise error(
                "ARGUMENT_INVALID",
                f"limits.{key} {value:g} is above {limits[key]:g} of [limits]; lower it, or set "
                "allow_job_override there",
            )
        limits[key] = value
    return replace(values, limits=limits)
