"""A test of pose accuracy and repeatability in words, and its plan."""

from collections.abc import Mapping
from typing import Any

from procedures.iso9283.result import Figure, Iso9283Result, PoseResult
from procedures.plan_words import margins
from procedures.words import mm, pose_text, table

_HEADER = (
    "pose",
    "joint range (deg)",
    "keep-out (mm)",
    "workspace (mm)",
    "floor (mm)",
    "self (mm)",
    "singular",
)


def iso9283_lines(found: Iso9283Result) -> list[str]:
    """AP and RP of every pose beside the tracker's own, how the tracker was placed, and what is open."""
    answer, tracker, place = found.result, found.result.tracker, found.result.registration
    how = "through its calibrated kinematics" if answer.corrected else "by the model of its controller"
    lines = [
        f"  {answer.cycles} cycles, the arm commanded {how}, payload {answer.payload_kg:g} kg, "
        f"{100 * answer.speed_share:g} % speed",
        f"  {answer.formula.AP}",
        f"  {answer.formula.RP}",
        f"  the tracker's own: sigma {mm(tracker.sigma_axis_m)} per axis, AP {mm(tracker.AP_95_m)} "
        f"(95 %), RP {mm(tracker.RP_m)}; no figure is given below it",
    ]
    for pose in answer.poses:
        lines.append(f"  {pose.name}: AP {_shown(pose, 'AP')}, RP {_shown(pose, 'RP')}")
    used = "fitted to these poses" if place.how == "fit" else "taken from the calibration"
    lines.append(f"  the tracker's place is {used}: T_base_tracker = {pose_text(place.T_base_tracker)}")
    return lines + [f"  not measured: {words}" for words in found.observability.undetermined]


def _shown(pose: PoseResult, key: Figure) -> str:
    shown, measured, resolved = pose.figure(key)
    return mm(shown) if resolved else f"{mm(shown)} (the tracker's own; measured {mm(measured)})"


def iso9283_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """Every pose with its margins, and the order of visits."""
    shifts = [pose["shift_m"] for pose in plan["poses"]]
    lines = [
        table(_HEADER, ([pose["pose"], *margins(pose)] for pose in plan["poses"])),
        f"{plan['arrivals']} arrivals: {plan['cycles']} cycles of {', '.join(plan['order'])} at "
        f"{100 * plan['speed_share']:g} % of the cell's speed; R poses are visited once, to find the tracker",
    ]
    if plan["corrected"]:
        lines.append(f"the calibrated kinematics move the targets by up to {mm(max(shifts))}")
    return lines
