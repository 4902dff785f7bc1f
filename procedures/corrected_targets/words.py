"""Targets that were handed to an observed arm, and the plan of it, in words."""

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any

from procedures.corrected_targets.result import Reached, TargetsResult
from procedures.words import mm, pose_text, table


def command_text(command: Sequence[float]) -> str:
    """What to command the controller: x, y, z, yaw of a palletizer, else a pose."""
    if len(command) != 4:
        return pose_text(command)
    x, y, z = (f"{1e3 * v:.3f}" for v in command[:3])
    return f"x {x} mm, y {y} mm, z {z} mm, yaw {degrees(command[3]):.4f} deg"


def targets_lines(found: TargetsResult) -> list[str]:
    """What remained off at each target before and after, and what says so."""
    answer = found.result
    seen = (
        f"a tracker at reflector {answer.reflector}"
        if answer.seen_by == "tracker"
        else "the joints and the calibrated arm; no tracker looked"
    )
    before = "not asked for" if answer.before is None else _all(answer.before.rms_m, answer.before.max_m)
    lines = [
        f"  {answer.after.targets} targets of {answer.arm}, by {seen}",
        f"  off as given: {before}",
        f"  off corrected: {_all(answer.after.rms_m, answer.after.max_m)}",
    ]
    for target in answer.targets:
        lines.append(
            f"  target {target.number}: {_off(target.before)} as given, {_off(target.after)} corrected; "
            f"command {command_text(target.command)}"
        )
    return lines + [f"  not measured: {words}" for words in found.observability.undetermined]


def _all(rms: float, largest: float) -> str:
    return f"{mm(rms)} RMS, {mm(largest)} at the worst target"


def _off(reached: Reached | None) -> str:
    if reached is None:
        return "not measured"
    bound = "" if reached.error_95_m is None else f" ± {mm(reached.error_95_m)}"
    return mm(reached.error_m) + bound


def targets_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """What would be asked for, target by target."""
    rows = [
        (str(t["number"]), command_text(t["command"]), ", ".join(f"{degrees(v):.3f}" for v in t["corrected"]))
        for t in plan["targets"]
    ]
    outside = plan.get("outside_sampled")
    return [
        table(("target", "command", "joints (deg)"), rows),
        f"the calibrated arm moves the targets by up to {mm(max(t['shift_m'] for t in plan['targets']))}",
        *([outside] if outside else []),
    ]
