"""The rule of thumb for poses in a plan: 50, and every joint turns by more than 15 degrees to the next."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.identification.selection import RULE_ANGLE, RULE_POSES, SourceRule
from cell.errors import error
from cell.joint_limits import leading_speed, per_joint
from cell.poses import Array
from procedures.tracker.visit_order import travel


def rule_text(rule: SourceRule) -> str:
    """The rule in words, kept or not."""
    if rule.kept:
        return f"{rule.poses} poses, every joint more than 15 deg from one to the next"
    return f"{rule.poses} of 50 poses, {rule.short_steps} steps with a joint that moves 15 deg or less"


def rule_entry(rule: SourceRule) -> dict[str, Any]:
    """For the listing of a plan."""
    return {
        "kept": rule.kept,
        "samples": rule.poses,
        "short_steps": rule.short_steps,
        "smallest_step_rad": rule.smallest_rad if np.isfinite(rule.smallest_rad) else None,
        "meaning": "a rule of thumb asks for 50 poses, every joint more than 15 deg from one to the next",
    }


def short_steps(links: Array) -> Array:
    """(n - 1, j): which joints turn too little on each step of ``links`` (n, j), rad at the links."""
    short: Array = np.abs(np.diff(links, axis=0)) <= RULE_ANGLE
    return short


def require_kept(poses: int, links: Array, ranges: Array, lost: Sequence[Mapping[str, Any]]) -> None:
    """``TRACKER_PLAN_REFUSED`` where steps still to be made are too short, with the joint that turns too
    little most often, or where fewer than 50 ``poses`` to solve from are left, with why some were ``lost``.

    ``links`` (n, j) are the poses still to come in their order, after the last measured one if there is one,
    and ``ranges`` (j, 2) what a joint may be, rad at the links.
    """
    short = short_steps(links)
    if count := int(short.any(axis=1).sum()):
        worst = int(np.argmax(short.sum(axis=0)))
        range_deg = np.degrees(np.ptp(ranges[worst]))
        raise error(
            "TRACKER_PLAN_REFUSED",
            f"keep_rule: {poses} of {RULE_POSES} poses, {count} steps to come with a joint that moves 15 deg "
            f"or less; most often joint {worst + 1}, whose range is {range_deg:.0f} deg: widen "
            "joint_ranges_rad or the space that is free and seen, or leave keep_rule out",
        )
    if poses < RULE_POSES:
        why = f"; {len(lost)} have no free way to them, the first one: {lost[0]['why']}" if lost else ""
        raise error(
            "TRACKER_PLAN_REFUSED",
            f"keep_rule: {poses} of {RULE_POSES} poses to solve from are left{why}. Raise poses, or leave "
            "keep_rule out",
        )


def rule_cost(path: Array, shortest: Array, limits: Mapping[str, Any] | None) -> dict[str, float]:
    """Travel (rad) along ``path`` (n, j) and along the ``shortest`` one through the same poses; with the
    ``limits`` of an arm how long it takes, s, with a rest at each pose."""
    cost = {"travel_rad": float(travel(path).sum()), "shortest_rad": float(travel(shortest).sum())}
    if limits is not None:
        speeds, a = per_joint(limits["joint_speed_rad_s"]), limits["joint_accel_rad_s2"]
        for key, visits in (("moving_s", path), ("shortest_s", shortest)):
            way, v = travel(visits), leading_speed(np.diff(visits, axis=0), speeds)
            times = np.where(way > v * v / a, way / v + v / a, 2.0 * np.sqrt(way / a))
            cost[key] = float(times.sum())
    return cost
