"""The motion guard: joint ranges, boxes, reach and speeds, checked before anything moves."""

from cell.guard.guard import PLANNED_CLEAR_M, MotionGuard
from cell.guard.limits import GuardLimits, Tool

__all__ = ["PLANNED_CLEAR_M", "GuardLimits", "MotionGuard", "Tool"]
