"""Tools whose load nobody has told: which configured jobs would move the arm with one of them."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from cell.store.files import to_json
from daemon.config.findings import Findings
from daemon.config.recipes import with_sections
from daemon.config.tables import table
from daemon.config.tools import known_tools, usual_name


def check_loads(
    raw: Mapping[str, Any], jobs: Mapping[str, Any], roles: Mapping[str, Any], findings: Findings
) -> None:
    """What the flange carries is measured. A load that is left out is a problem of the jobs and recipes whose
    start would move the arm with it, and else a warning; a twin without one carries nothing.

    ``jobs`` are those of the cell by their names.
    """
    robot, tools = table(raw, "robot"), table(raw, "tool")
    untold = [name for name in known_tools(raw) if "payload_kg" not in {**robot, **table(tools, name)}]
    if not untold or "arm" not in roles or table(raw, "cell").get("twin", False) is not False:
        return
    barred: dict[str, list[str]] = {}
    for start, tool in _moving(raw, jobs):
        # A start that has to name a tool can name one whose load is told.
        unnamed = untold if tool is None and len(untold) == len(known_tools(raw)) else []
        for name in unnamed if tool is None else [tool]:
            barred.setdefault(name, []).append(start)
    for name in untold:
        place = ("tool", name, "payload_kg") if name in tools else ("robot", "payload_kg")
        remedy = "weigh what is on the flange, or write 0.0"
        if starts := barred.get(name):
            text = f"is missing, so {', '.join(starts)} may not move the arm with tool '{name}': {remedy}"
            findings.add_problem(place, text)
        else:
            findings.warn(place, f"is missing, so no job may move the arm with tool '{name}': {remedy}")


def _moving(raw: Mapping[str, Any], jobs: Mapping[str, Any]) -> Iterator[tuple[str, str | None]]:
    """The configured jobs and recipes that move the arm, each with the tool of a start that names none; None
    where it has to."""
    sections, recipes = table(raw, "job"), table(raw, "recipe")
    starts = [(name, name, dict[str, Any]()) for name in sections]
    starts += [(name, str(table(recipes, name).get("job")), table(recipes, name)) for name in recipes]
    for start, job, parameters in starts:
        if job in jobs and _moves(raw, jobs[job], job, parameters):
            own = parameters.get("tool", table(sections, job).get("tool"))
            yield start, own if isinstance(own, str) else usual_name(raw)


def _moves(raw: Mapping[str, Any], job: Any, name: str, parameters: Mapping[str, Any]) -> bool:
    own = {key: value for key, value in parameters.items() if key not in ("job", "number")}
    try:
        config = job.Config.model_validate_json(to_json(with_sections(raw, job, name, own)), strict=True)
    except ValidationError:  # which is told by itself
        return False
    return "arm" in job(config).uses()
