"""Arm models: published and factory-calibrated UR arms, forward and inverse kinematics."""

from calibration.kinematics.spec import measured_arm, robot_from_spec
from calibration.kinematics.ur import DhDeltas, UrArmModel
from calibration.kinematics.ur_models import UR_MODELS

__all__ = ["UR_MODELS", "DhDeltas", "UrArmModel", "measured_arm", "robot_from_spec"]
