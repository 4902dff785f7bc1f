"""The plan of a dry run as a table: every pose with every check."""

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any

from procedures.words import deg, table

HEADER = (
    "pose", "joints (deg)", "travel (deg)", "joint range (deg)", "keep-out (mm)", "workspace (mm)",
    "floor (mm)", "self (mm)", "singular",
)  # fmt: skip


def plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """The poses with the margin of each to each limit; nothing in it may be negative."""
    lines = []
    if poses := plan.get("poses"):
        about = f", cone about {plan['axis']}" if "axis" in plan else ""
        lines += [
            f"{len(poses)} poses{about}; margins to the limits:",
            table(HEADER, (_row(pose) for pose in poses)),
        ]
    if plan.get("travel_rad") is not None:
        lines.append(
            f"joint travel {deg(plan['travel_rad'], 0)}; "
            f"turning about a second axis {deg(plan['spread_rad'], 1)} RMS"
        )
    if rejected := plan.get("rejected"):
        lines.append(f"{len(rejected)} poses are left out:")
        lines += [f"  {r['index']}: {r['reason']}" for r in rejected]
    return lines


def _row(pose: Mapping[str, Any]) -> list[str | None]:
    return [str(pose["index"]), joints_text(pose["q"]), _angle(pose.get("travel_rad")), *margins(pose)]


def joints_text(q: Sequence[float]) -> str:
    """Joints (rad) in degrees."""
    return " ".join(f"{round(degrees(v), 1) + 0.0:.1f}" for v in q)


def margins(pose: Mapping[str, Any]) -> list[str | None]:
    """The cells of a row with a pose's margins to the limits."""
    checks = pose.get("checks", {})
    return [
        _named(_angle(checks.get("joint_rad")), checks.get("joint")),
        _named(_length(checks.get("clearance_m")), checks.get("clearance")),
        _length(checks.get("workspace_m")),
        _length(checks.get("floor_m")),
        _length(checks.get("self_m")),
        None if checks.get("singularity") is None else f"{checks['singularity']:.3f}",
    ]


def _angle(radians: float | None) -> str | None:
    return None if radians is None else f"{degrees(radians):.1f}"


def _length(metres: float | None) -> str | None:
    """A margin in mm; without walls it is endless."""
    return None if metres is None or metres > 1e3 else f"{1e3 * metres:.0f}"


def _named(margin: str | None, name: str | None) -> str | None:
    return margin if margin is None or not name else f"{margin} {name}"
