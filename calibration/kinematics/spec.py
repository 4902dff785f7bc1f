"""From the ROBOT of a data set or config to an arm model."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.kinematics.chain_arm import ChainArm
from calibration.kinematics.families import arm_spec
from calibration.kinematics.serial6 import Serial6Arm
from calibration.kinematics.ur import DhDeltas, UrArmModel
from calibration.kinematics.ur_models import UR_MODELS
from cell.arm_model import ArmModel
from cell.errors import error
from cell.formats.robot import Serial6Robot, parse_robot
from cell.poses import Array

_DELTAS = ("delta_theta", "delta_d", "delta_a", "delta_alpha")
_KEYS = {"model", "calibration", "tool", "prior", "notes"}
_SAME_ARM_M = 0.05  # of the flange; arms differ from their drawing by millimetres


JointRanges = Sequence[Sequence[float]]


def robot_from_spec(spec: Mapping[str, Any], joint_ranges: JointRanges | None = None) -> ArmModel:
    """The arm that ``{"model": "ur10e", "calibration": {...}}`` names, or one of family ``serial6``.

    ``joint_ranges`` (6, 2) rad: where the joints stay, within what the arm can. ``DATA_INVALID`` for anything
    else.
    """
    return _within(_chain_arm(spec), joint_ranges)


def _within(arm: ChainArm, joint_ranges: JointRanges | None) -> ChainArm:
    return arm if joint_ranges is None else arm.narrowed(np.array(joint_ranges, dtype=float))


def _chain_arm(spec: Mapping[str, Any]) -> ChainArm:
    supported = ", ".join(UR_MODELS)
    if spec.get("family") == "serial6":
        robot = parse_robot(spec, "robot")
        if not isinstance(robot, Serial6Robot):
            raise error("INTERNAL", "family serial6 was read as another one")
        return Serial6Arm(robot)
    if "family" in spec:
        raise error(
            "DATA_INVALID",
            f"robot: family {spec['family']!r} cannot be moved or planned for; use family 'serial6', "
            f"or a model of {supported}",
        )
    if unknown := sorted(set(spec) - _KEYS):
        raise error(
            "DATA_INVALID", f"robot: unknown key {unknown[0]!r}; known are {', '.join(sorted(_KEYS))}"
        )
    model = spec.get("model")
    if not isinstance(model, str) or model not in UR_MODELS:
        raise error("DATA_INVALID", f"robot: model {model!r} is not supported; supported are {supported}")
    calibration = spec.get("calibration")
    return UrArmModel(model, None if calibration is None else _deltas(calibration))


def measured_arm(
    believed: Mapping[str, Any], measured: Mapping[str, Any], joint_ranges: JointRanges | None = None
) -> ArmModel:
    """The arm that the ROBOT ``believed`` names, with its flange where the ROBOT ``measured`` has it, and
    its joints within ``joint_ranges`` (6, 2) rad.

    ``measured`` is what a tracker found of the same arm: six joints in series, or a model with deltas.
    ``DATA_INVALID`` when it is no such chain, or that of another arm.
    """
    nominal = _chain_arm(believed)
    chain = arm_spec(parse_robot(measured, "kinematics.robot"), "kinematics.robot").arm.base
    if len(chain.theta) != 6 or not chain.plain:
        raise error(
            "DATA_INVALID", "kinematics.robot: an arm that is moved has six joints, each with its own link"
        )
    arm = nominal.measured(chain)
    Q = np.array([np.full(6, 0.3), np.full(6, -1.2)])
    apart = np.linalg.norm(arm.forward_many(Q).translation - nominal.forward_many(Q).translation, axis=1)
    if float(apart.max()) > _SAME_ARM_M:
        raise error(
            "DATA_INVALID",
            f"kinematics.robot: its flange is up to {1e3 * apart.max():.0f} mm off that of a {nominal.name}, "
            "so it is another arm",
        )
    return _within(arm, joint_ranges)


def _deltas(calibration: Any) -> DhDeltas:
    if not isinstance(calibration, Mapping):
        raise error("DATA_INVALID", f"robot.calibration: need a table with {', '.join(_DELTAS)}")
    if unknown := sorted(set(calibration) - set(_DELTAS)):
        raise error(
            "DATA_INVALID", f"robot.calibration: unknown key {unknown[0]!r}; known are {', '.join(_DELTAS)}"
        )
    return DhDeltas(**{key: _six(key, calibration[key]) for key in _DELTAS if key in calibration})


def _six(key: str, values: Any) -> Array:
    try:
        row = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        row = np.empty(0)
    if row.shape != (6,) or not np.all(np.isfinite(row)):
        raise error(
            "DATA_INVALID", f"robot.calibration.{key}: need 6 finite numbers, one per joint; got {values!r}"
        )
    return row
