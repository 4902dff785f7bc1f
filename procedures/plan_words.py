"""The plan of a dry run as a table: every pose with every check."""

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any

from procedures.hand_eye.words import prediction_text
from procedures.words import deg, mm, table

HEADER = (
    "pose", "joints (deg)", "travel (deg)", "joint range (deg)", "keep-out (mm)", "workspace (mm)",
    "floor (mm)", "self (mm)", "singular",
)  # fmt: skip
SWEEP_HEADER = (
    "move", "across", "tool's point from (mm)", "to (mm)", "joint range (deg)", "keep-out (mm)",
    "workspace (mm)", "floor (mm)", "self (mm)", "singular",
)  # fmt: skip


def plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """Poses or sweeps with the margin of each to each limit; nothing in it may be negative."""
    lines = []
    if poses := plan.get("poses"):
        lines += [
            f"{len(poses)} poses, cone about {plan.get('axis', 'the board')}; margins to the limits:",
            table(HEADER, (_row(pose) for pose in poses)),
        ]
    lines += _sweeps(plan)
    if plan.get("travel_rad") is not None:
        lines.append(
            f"joint travel {deg(plan['travel_rad'], 0)}; "
            f"turning about a second axis {deg(plan['spread_rad'], 1)} RMS"
        )
    if rejected := plan.get("rejected"):
        lines.append(f"{len(rejected)} poses are left out:")
        lines += [f"  {r['index']}: {r['reason']}" for r in rejected]
    if predicted := plan.get("predicted"):
        lines.append(prediction_text(predicted))
    return lines


def _sweeps(plan: Mapping[str, Any]) -> list[str]:
    """The moves of a crossed-beam job in order; 'across' says how often one crosses a beam and comes back."""
    sweeps = plan.get("sweeps", [])
    if not sweeps:
        return []
    lines = [
        "Every move in order, with the margins to the limits where it is tightest:",
        table(SWEEP_HEADER, map(_sweep, sweeps)),
    ]
    if (floor := plan.get("floor_m")) is not None:
        lines.append(f"the tool's point does not go below {mm(floor, 1)} in base")
    problems = plan.get("problems") or []
    lines += [f"not possible: {problem}" for problem in problems]
    return lines


def _sweep(row: Mapping[str, Any]) -> list[str | None]:
    sweeps = row.get("sweeps")
    times = str(sweeps) if sweeps else None  # an approach crosses nothing
    return [str(row["index"]), times, _at(row.get("from")), _at(row.get("to")), *margins(row)]


def _at(point: Sequence[float] | None) -> str | None:
    return None if point is None else " ".join(f"{round(1e3 * v, 1) + 0.0:.1f}" for v in point)


def _row(pose: Mapping[str, Any]) -> list[str | None]:
    joints = " ".join(f"{round(degrees(v), 1) + 0.0:.1f}" for v in pose["q"])
    return [str(pose["index"]), joints, _angle(pose.get("travel_rad")), *margins(pose)]


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
