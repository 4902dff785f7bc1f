"""The plan of a crossed-beam job as a table: every move with every check."""

from collections.abc import Mapping, Sequence
from typing import Any

from procedures.plan_words import margins
from procedures.words import mm, table

SWEEP_HEADER = (
    "move", "across", "tool's point from (mm)", "to (mm)", "joint range (deg)", "keep-out (mm)",
    "workspace (mm)", "floor (mm)", "self (mm)", "singular",
)  # fmt: skip


def sweep_plan_lines(plan: Mapping[str, Any]) -> list[str]:
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
