"""Calibration targets: image in, numbered corners out. No files, no devices."""

from calibration.targets.base import Detection, Target
from calibration.targets.factory import PointsTarget, make_target

__all__ = ["Detection", "PointsTarget", "Target", "make_target"]
