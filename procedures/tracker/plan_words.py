"""The plan of a tracker sampling as tables: every pose in order with every check, and what they promise."""

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any

from procedures.plan_words import margins
from procedures.words import mm, table

HEADER = (
    "pose", "reflector", "for", "joints (deg)", "by way of", "range (m)", "joint range (deg)",
    "keep-out (mm)", "workspace (mm)", "floor (mm)", "self (mm)", "singular",
)  # fmt: skip


def tracker_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """Every pose in its order with its margins to the limits, and the expected error."""
    lines = []
    if locate := plan.get("locate"):
        lines.append(f"{len(locate)} poses come first, to find the tracker's place:")
        lines.append(table(HEADER, (_row(pose, "place") for pose in locate)))
    poses = plan["poses"]
    lines.append(f"{len(poses)} poses in their order; margins to the limits:")
    lines.append(table(HEADER, (_row(p, "check" if p["held_out"] else "solve") for p in poses)))
    for lost in plan.get("lost") or []:
        lines.append(f"left out: no free way to {_joints(lost['q'])} ({lost['why']})")
    if plan.get("not_possible"):
        lines.append(f"of the poses that were tried were not possible: {plan['not_possible']}")
    lines.append(_promise(plan))
    lines += [f"  stays open: {words}" for words in plan.get("unidentifiable") or []]
    return lines


def rule_words(plan: Mapping[str, Any]) -> str:
    """Whether the rule of thumb is kept, and what that costs beside the shortest order of the same poses."""
    rule, cost = plan["source_rule"], plan.get("by_rule")
    if not rule["kept"]:
        return (
            f"is not kept: {rule['samples']} poses, {rule['short_steps']} steps with a joint that moves less"
        )
    if cost is None:
        return "is kept"
    turned, least = degrees(cost["travel_rad"]), degrees(cost["shortest_rad"])
    ways = f"joints turn {turned:.0f} deg from pose to pose, {least:.0f} deg in the shortest order"
    if "moving_s" not in cost:
        return f"is kept by their order: {ways}"
    seconds, fewest = cost["moving_s"], cost["shortest_s"]
    return f"is kept by their order, which costs {seconds - fewest:.0f} s of {seconds:.0f} s ({ways})"


def _row(pose: Mapping[str, Any], purpose: str) -> list[str | None]:
    distance = pose.get("range_m")
    return [
        str(pose["index"]),
        pose["reflector"],
        purpose,
        _joints(pose["q"]),
        "home" if pose["via"] else None,
        None if distance is None else f"{distance:.2f}",
        *margins(pose),
    ]


def _joints(q: Sequence[float]) -> str:
    return " ".join(f"{round(degrees(v), 1) + 0.0:.1f}" for v in q)


def _promise(plan: Mapping[str, Any]) -> str:
    predicted = plan["predicted"]
    assumed = predicted["assuming"]
    return (
        f"expected error of predictions {mm(predicted['rms_m'], 4)} (RMS), 95 % below "
        f"{mm(predicted['error_95_max_m'], 4)} at the worst place, with a tracker of "
        f"{mm(assumed['sigma0'])} + {mm(assumed['sigma_per_m'])}/m; rank {plan['rank']} of "
        f"{plan['rank_possible']} possible; the rule of thumb (50 poses, every joint 15 deg from "
        f"one to the next) {rule_words(plan)}"
    )
