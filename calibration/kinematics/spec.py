"""From the ROBOT of a data set or config to an arm model."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.kinematics.chain import DhChain
from calibration.kinematics.families import arm_spec
from calibration.kinematics.ur import DhDeltas, UrArm
from calibration.kinematics.ur_models import UR_MODELS
from cell.arm_model import ArmModel
from cell.errors import error
from cell.formats.robot import parse_robot
from cell.poses import Array

_DELTAS = ("delta_theta", "delta_d", "delta_a", "delta_alpha")
_KEYS = {"model", "calibration", "tool", "prior", "notes"}
_SAME_ARM_M = 0.05  # of the flange; arms differ from their drawing by millimetres


def robot_from_spec(spec: Mapping[str, Any]) -> ArmModel:
    """The arm that ``{"model": "ur10e", "calibration": {...}}`` names; ``DATA_INVALID`` for anything else."""
    supported = ", ".join(UR_MODELS)
    if "family" in spec:
        raise error(
            "DATA_INVALID",
            f"robot: family {spec['family']!r} cannot be moved or planned for; use a model of {supported}",
        )
    if unknown := sorted(set(spec) - _KEYS):
        raise error(
            "DATA_INVALID", f"robot: unknown key {unknown[0]!r}; known are {', '.join(sorted(_KEYS))}"
        )
    model = spec.get("model")
    if not isinstance(model, str) or model not in UR_MODELS:
        raise error("DATA_INVALID", f"robot: model {model!r} is not supported; supported are {supported}")
    calibration = spec.get("calibration")
    return UrArm(model, None if calibration is None else _deltas(calibration))


def measured_arm(believed: Mapping[str, Any], measured: Mapping[str, Any]) -> ArmModel:
    """The arm that the ROBOT ``believed`` names, with its flange where the ROBOT ``measured`` has it.

    ``measured`` is what a tracker found of the same arm: six joints in series, or a model with deltas.
    ``DATA_INVALID`` when it is no such chain, or that of another arm.
    """
    nominal = robot_from_spec(believed)
    chain = arm_spec(parse_robot(measured, "kinematics.robot"), "kinematics.robot").arm.base
    if chain.coupling.shape != (6, 6) or not np.array_equal(chain.coupling, np.eye(6)) or chain.sliding.any():
        raise error(
            "DATA_INVALID", "kinematics.robot: an arm that is moved has six joints, each with its own link"
        )
    arm = UrArm(nominal.name, measured=DhChain(chain.theta, chain.d, chain.a, chain.alpha, chain.beta))
    Q = np.array([np.full(6, 0.3), np.full(6, -1.2)])
    apart = np.linalg.norm(arm.forward_many(Q).translation - nominal.forward_many(Q).translation, axis=1)
    if float(apart.max()) > _SAME_ARM_M:
        raise error(
            "DATA_INVALID",
            f"kinematics.robot: its flange is up to {1e3 * apart.max():.0f} mm off that of a {nominal.name}, "
            "so it is another arm",
        )
    return arm


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
