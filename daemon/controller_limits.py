"""Joint limits of the cell against those that the arm's own controller tells of itself.

A controller stops an arm that goes beyond its own limits, in the middle of whatever is being measured, and an
arm that follows set-points faster than it may falls behind without a word.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cell.errors import error
from cell.joint_limits import JOINTS, per_joint
from cell.poses import Array
from daemon.config import CellConfig
from daemon.supervisor import Supervisor

_ROUNDED = 1e-3  # rad or rad/s: 3.142 is meant to be half a turn
_OR = "or raise what the robot's own safety configuration allows"


def told_by(config: CellConfig, supervisor: Supervisor) -> Mapping[str, Any]:
    """What the arm of this cell told of itself when it was connected; empty before, and without an arm."""
    entry = supervisor.devices.get(config.robot.roles().get("arm", ""))
    return entry.identity.extra if entry is not None and entry.identity is not None else {}


def limits_in_use(config: CellConfig, told: Mapping[str, Any]) -> dict[str, Any]:
    """``[limits]``, with the joint ranges that the controller ``told`` where none are configured.

    Not where they leave the arm all that it can: a run from before they were read can then be taken up.
    """
    limits = config.limits.model_dump(mode="json")
    own = told.get("joint_ranges_rad")
    return limits if own is None or not _less(config, own).any() else {"joint_ranges_rad": own, **limits}


def require_within(
    limits: Mapping[str, Any], told: Mapping[str, Any], speeds_from: str = "limits"
) -> dict[str, Any]:
    """``limits`` with joint ranges that end where the controller's do, where they were rounded beyond.

    ``LIMITS_BEYOND_CONTROLLER`` where they allow a joint more than the controller ``told``; ``speeds_from``
    is the section of the file that the joint speeds stand in.
    """
    if found := beyond(limits, told, speeds_from):
        raise error("LIMITS_BEYOND_CONTROLLER", "; ".join(found))
    ranges = limits.get("joint_ranges_rad")
    if ranges is None or (own := told.get("joint_ranges_rad")) is None:
        return dict(limits)
    within = _common(np.array(ranges, dtype=float), np.array(own, dtype=float))
    return {**limits, "joint_ranges_rad": within.tolist()}


def beyond(limits: Mapping[str, Any], told: Mapping[str, Any], speeds_from: str = "limits") -> list[str]:
    """What ``limits`` allow a joint beyond what the controller ``told``, for :func:`require_within`."""
    ranges = _too_far(limits.get("joint_ranges_rad"), told)
    return [*_too_fast(limits["joint_speed_rad_s"], told, speeds_from), *ranges]


def _too_fast(wanted: float | Sequence[float], told: Mapping[str, Any], section: str) -> list[str]:
    if (own := told.get("joint_speeds_rad_s")) is None:
        return []
    speeds, own = per_joint(wanted), np.array(own)
    beyond = [
        f"joint '{JOINTS[k]}' {speeds[k]:g} rad/s where the controller allows {own[k]:.3f} rad/s"
        for k in np.flatnonzero(speeds > own + _ROUNDED)
    ]
    fitting = [float(f"{v:.3f}") for v in np.minimum(speeds, _down(own))]
    fix = f"write {section}.joint_speed_rad_s = {fitting}, {_OR}"
    return [f"{section}.joint_speed_rad_s allows {', '.join(beyond)}: {fix}"] if beyond else []


def _too_far(wanted: Sequence[Sequence[float]] | None, told: Mapping[str, Any]) -> list[str]:
    if wanted is None or (own := told.get("joint_ranges_rad")) is None:
        return []
    ranges, own = np.array(wanted, dtype=float), np.array(own, dtype=float)
    far = (ranges[:, 0] < own[:, 0] - _ROUNDED) | (ranges[:, 1] > own[:, 1] + _ROUNDED)
    inside = _common(ranges, np.column_stack([-_down(-own[:, 0]), _down(own[:, 1])]))
    apart = inside[:, 0] >= inside[:, 1]
    beyond = [
        f"joint '{JOINTS[k]}' {_from_to(ranges[k])} where the controller allows {_from_to(own[k])}"
        for k in np.flatnonzero(far | apart)
    ]
    fix = f"write limits.joint_ranges_rad = {inside.tolist()}"
    if nowhere := ", ".join(f"'{JOINTS[k]}'" for k in np.flatnonzero(apart)):
        fix = f"joint {nowhere} cannot go there; choose another range"
    return [f"limits.joint_ranges_rad allows {', '.join(beyond)}: {fix}, {_OR}"] if beyond else []


def narrower_than_planned(config: CellConfig, told: Mapping[str, Any]) -> list[str]:
    """What is said of joints that the controller turns less far than the arm's model does, where no range is
    configured: jobs keep to that, and only a check without the arm does not know it."""
    own = told.get("joint_ranges_rad")
    if own is None or config.limits.joint_ranges_rad is not None:
        return []
    less = np.flatnonzero(_less(config, own, _ROUNDED))
    joints = ", ".join(f"joint '{JOINTS[k]}' {_from_to(own[k])}" for k in less)
    words = (
        f"the controller allows {joints}, which is less than the arm can: jobs keep to it; write it as "
        "limits.joint_ranges_rad, and predictions of 'cellward check' keep to it, too"
    )
    return [words] if joints else []


def _less(config: CellConfig, own: Sequence[Sequence[float]], margin_rad: float = 0.0) -> Array:
    """(6,): which joints the controller turns less far than the arm's model does, by more than a margin."""
    # With SciPy, for which a probe without an arm need not wait.
    from calibration.kinematics import robot_from_spec

    low, high = np.array(own, dtype=float).T
    model = robot_from_spec(config.robot.robot_spec()).joint_limits
    less: Array = (low > model[:, 0] + margin_rad) | (high < model[:, 1] - margin_rad)
    return less


def _common(ranges: Array, own: Array) -> Array:
    """(6, 2): where both allow a joint to be."""
    return np.column_stack([np.maximum(ranges[:, 0], own[:, 0]), np.minimum(ranges[:, 1], own[:, 1])])


def _down(limit: Array) -> Array:
    """A thousandth below, where rounding would end beyond."""
    return np.floor(limit * 1e3) / 1e3


def _from_to(ends: Sequence[float] | Array) -> str:
    return f"from {ends[0]:.3f} to {ends[1]:.3f} rad"
