"""From the values of a run to what a motion lease needs: guard, tool and speed."""

from collections.abc import Mapping
from typing import Any

from calibration.kinematics import robot_from_spec
from cell.devices import Speed, ToolSettings
from cell.guard import GuardLimits, MotionGuard, Tool
from cell.poses import from_pose6


def lease_settings(values: Mapping[str, Any]) -> tuple[MotionGuard, ToolSettings, Speed]:
    """Guard, tool and speed for a lease, from the values resolved at the run's start."""
    limits, tool = values["limits"], values["tool"]
    guard = MotionGuard(
        robot_from_spec(values["robot"]), GuardLimits.from_mapping(limits), Tool.from_mapping(tool)
    )
    settings = ToolSettings(
        from_pose6(tool["T_flange_tool"]), values["payload_kg"], tuple(values["centre_of_mass_m"])
    )
    speed = Speed(
        limits["speed_m_s"], limits["accel_m_s2"], limits["joint_speed_rad_s"], limits["joint_accel_rad_s2"]
    )
    return guard, settings, speed
