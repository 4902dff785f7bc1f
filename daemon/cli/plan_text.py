"""The plan of a dry run as a table: every pose with every check."""

from collections.abc import Mapping
from math import degrees
from typing import Any

from daemon.cli.output import table


def plan_text(plan: Mapping[str, Any]) -> str:
    """What a job would do. Joints in degrees; other values as the job names them, with their SI units."""
    lines = [f"{key}: {_cell(key, value)}" for key, value in plan.items() if key not in ("poses", "note")]
    if note := plan.get("note"):
        lines.append(str(note))
    poses = plan.get("poses", [])
    if poses:
        columns = list(dict.fromkeys(key for pose in poses for key in pose))
        header = ["q (deg)" if c == "q" else c for c in columns]
        lines.append(table(header, [[_cell(c, pose.get(c)) for c in columns] for pose in poses]))
    lines.append("Nothing was moved.")
    return "\n".join(lines)


def _cell(key: str, value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if key == "q":
        return " ".join(f"{degrees(v):.1f}" for v in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_cell(k, v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return " ".join(_cell("", v) for v in value)
    return str(value)
