"""Which joints are asked for at each target, as given and corrected; nothing here touches a device."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.identification.application import (
    Reached,
    chain_of,
    goals_from_yaw,
    reach,
    reach_inside,
    yaw_of,
)
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import arm_spec
from cell.errors import error
from cell.formats.corrected_targets import PlannedTarget
from cell.formats.robot import parse_robot
from cell.poses import Array, from_pose6, to_pose6
from cell.run_values import RunValues
from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.corrected_targets.joint_ranges import JointRanges
from procedures.kinematics_in_use import other_arm, other_device, other_load

_LOAD = "[job.corrected-targets] payload_kg"
LEVEL_JOINTS = 4  # such an arm keeps its flange level: a target is x, y, z and a heading


def calibrated_of(values: RunValues, config: CorrectedTargetsConfig) -> Mapping[str, Any]:
    """The accepted kinematics of the observed arm.

    ``OBSERVED_MODEL_MISSING``, ``TARGETS_NO_KINEMATICS`` without any or of another arm, ``PAYLOAD_DIFFERS``;
    ``ARGUMENT_INVALID`` for a reflector that they do not know.
    """
    if not values.observed_robot:
        raise error("OBSERVED_MODEL_MISSING")
    found = values.kinematics.get("observed_arm")
    if found is None:
        raise error("TARGETS_NO_KINEMATICS", "nothing was accepted yet")
    if why := other_arm(found, values.observed_robot):
        raise error("TARGETS_NO_KINEMATICS", why)
    if config.payload_kg is not None and (why := other_load(found, config.payload_kg, _LOAD)):
        raise error("PAYLOAD_DIFFERS", why)
    if config.reflector is not None:
        place_of(found["robot"], config.reflector)
    return found


def require_same_devices(found: Mapping[str, Any], serials: Mapping[str, str]) -> None:
    """``TARGETS_NO_KINEMATICS`` where arm or tracker is not that of the calibration ``found``."""
    for role, serial in serials.items():
        if why := other_device(found, role, serial):
            raise error("TARGETS_NO_KINEMATICS", why)


def place_of(robot: Mapping[str, Any], reflector: str | None) -> Array:
    """(3,) m in the flange: the reflector as the ROBOT has it, the flange's own origin without one."""
    if reflector is None:
        return np.zeros(3)
    tools = arm_spec(parse_robot(robot, "robot")).tools
    if reflector not in tools:
        known = ", ".join(tools) or "none"
        raise error(
            "ARGUMENT_INVALID",
            f"reflector = '{reflector}' is not known to the calibration of the arm; it knows {known}",
        )
    return tools[reflector]


def plan_targets(values: RunValues, raw: Mapping[str, Any], q_now: list[float]) -> list[PlannedTarget]:
    """Joints of every target; ``TARGETS_UNREACHABLE`` names one that a model of the arm cannot reach within
    the joint ranges with which it was sampled.

    As given are the joints that the controller's own model has for it, closest to ``q_near``, else to the
    middle of what was sampled; corrected those of the calibrated arm next to them. ``q_now`` stands in where
    the kinematics do not say what was sampled.
    """
    config = CorrectedTargetsConfig.model_validate(raw)
    found = calibrated_of(values, config)
    controller, calibrated = chain_of(values.observed_robot or {}), chain_of(found["robot"])
    ranges = JointRanges.of(found)
    near = _hint(config, ranges, q_now)
    goals, level = wanted(config, controller.joints)
    given = branch_of(controller, goals, near, ranges)
    corrected = joints_of(calibrated, goals, given, "the calibrated arm")
    ranges.require_inside(corrected, "the calibrated arm")
    told = controller.flange(corrected)
    commands = np.column_stack([told[:, :3, 3], yaw_of(told)]) if level else _poses(told)
    return [
        PlannedTarget(T_base_flange=pose, given=q, corrected=c, command=command)
        for pose, q, c, command in zip(
            _poses(goals).tolist(), given.tolist(), corrected.tolist(), commands.tolist(), strict=True
        )
    ]


def wanted(config: CorrectedTargetsConfig, joints: int) -> tuple[Array, bool]:
    """(k, 4, 4) poses of the flange, and whether only the heading is asked for."""
    level = joints == LEVEL_JOINTS
    length = LEVEL_JOINTS if level else 6
    for k, target in enumerate(config.targets):
        if len(target) != length:
            numbers = "x, y, z, yaw" if level else "x, y, z, rx, ry, rz"
            raise error(
                "ARGUMENT_INVALID",
                f"targets[{k}] has {len(target)} numbers; an arm with {joints} joints needs {numbers}",
            )
    rows = np.array(config.targets, dtype=float)
    goals = goals_from_yaw(rows) if level else np.array([from_pose6(row).as_matrix() for row in rows])
    return goals, level


def needs_joints(values: RunValues, config: CorrectedTargetsConfig) -> bool:
    """Whether the branch is that of where the arm stands, as nothing else tells it."""
    return config.q_near is None and JointRanges.of(calibrated_of(values, config)).middle is None


def _hint(config: CorrectedTargetsConfig, ranges: JointRanges, q_now: list[float]) -> Array:
    if config.q_near is not None:
        return np.array(config.q_near, dtype=float)
    return np.array(q_now, dtype=float) if ranges.middle is None else ranges.middle


def branch_of(chain: SerialChain, goals: Array, near: Array, ranges: JointRanges) -> Array:
    """(k, j): joints of the controller's own model for poses (k, 4, 4): the closest to ``near`` (j,) of those
    within ``ranges``."""
    whose = "the controller's own model"
    if near.shape != (chain.joints,):
        raise error("ARGUMENT_INVALID", f"q_near has {near.size} joints; the arm has {chain.joints}")
    if ranges.allowed is None:
        return joints_of(chain, goals, np.tile(near, (len(goals), 1)), whose)
    if ranges.allowed.shape != (chain.joints, 2):
        raise error(
            "ARGUMENT_INVALID",
            f"joint_ranges_rad of the sampling has {len(ranges.allowed)} entries; the arm has {chain.joints} "
            "joints",
        )
    found = reach_inside(chain, goals, near, ranges.allowed, level=chain.joints == LEVEL_JOINTS)
    _require_reached(found, whose)
    ranges.require_inside(found.q, whose)
    return found.q


def joints_of(chain: SerialChain, goals: Array, near: Array, whose: str) -> Array:
    """(k, j): joints of ``chain`` for poses (k, 4, 4), each in the branch of ``near`` (k, j)."""
    found = reach(chain, goals, near, near, level=chain.joints == LEVEL_JOINTS)
    _require_reached(found, whose)
    return found.q


def _require_reached(found: Reached, whose: str) -> None:
    for k in np.flatnonzero(~found.found):
        raise error(
            "TARGETS_UNREACHABLE",
            f"target {k + 1}: {whose} does not reach it; the best attempt stays {1e3 * found.miss[k]:.1f} mm "
            "(or mrad) off",
        )


def _poses(T: Array) -> Array:
    """(k, 6) of (k, 4, 4)."""
    return to_pose6(RigidTransform.from_matrix(T))
