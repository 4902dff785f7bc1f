"""Calibration targets: image in, numbered corners out. No files, no devices."""

from calibration.targets.base import Target
from calibration.targets.factory import make_target

__all__ = ["Target", "make_target"]
