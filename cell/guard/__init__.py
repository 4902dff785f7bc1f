"""The motion guard: joint ranges, boxes, reach and speeds, checked before anything moves."""

from cell.guard._margins import PoseMargins
from cell.guard.guard import PLANNED_CLEAR_M, MotionGuard
from cell.guard.limits import Box, GuardLimits, Tool

__all__ = ["PLANNED_CLEAR_M", "Box", "GuardLimits", "MotionGuard", "PoseMargins", "Tool"]
