"""``[recipe.NAME]``: a job with some of its arguments, under a name, and for a PLC under a number."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from cell.store.files import to_json
from daemon.config.findings import Findings, did_you_mean
from daemon.config.section import Section
from daemon.config.tables import tables
from daemon.config.tools import check_tool_of, known_tools

NAME = r"^[\w-]{1,32}$"
LOWEST_NUMBER, HIGHEST_NUMBER = 100, 255  # behind the jobs', and what a CAN frame holds


class RecipeSection(Section):
    """A job with arguments. Further keys are those of the job's section, and `tool`; a table replaces that of
    the section as a whole."""

    job: str = Field(description="the job that is started")
    number: int | None = Field(
        default=None,
        ge=LOWEST_NUMBER,
        le=HIGHEST_NUMBER,
        description="by which a PLC starts it, as the number of a job; without it it cannot",
    )


class Recipe(BaseModel):
    """A recipe of the cell: ``parameters`` are keys of the job's section, and ``tool``."""

    model_config = {"frozen": True}

    job: str
    number: int | None
    parameters: dict[str, Any]


def check_recipes(raw: Mapping[str, Any], jobs: Mapping[str, Any], findings: Findings) -> dict[str, Recipe]:
    """The recipes of parsed TOML; ``jobs`` are those of the cell by their names."""
    numbers = {getattr(job, "number", None): f"the job '{name}'" for name, job in jobs.items()}
    found = {}
    for name, section in tables(raw.get("recipe")).items():
        place = ("recipe", name)
        if name in jobs:
            findings.add(place, "a job has this name; give the recipe another one")
        parameters = {key: value for key, value in section.items() if key not in RecipeSection.model_fields}
        own = {key: value for key, value in section.items() if key not in parameters}
        try:
            said = RecipeSection.model_validate(own)
        except ValidationError as exc:
            findings.add_validation(place, own, RecipeSection, exc)
            continue
        own_name = f"[recipe.{name}]"
        if said.number is not None and (other := numbers.setdefault(said.number, own_name)) != own_name:
            findings.add((*place, "number"), f"{said.number} is the number of {other}, too")
        check_tool_of(section, place, known_tools(raw), findings)
        if said.job in jobs:
            _check_parameters(raw, jobs[said.job], said.job, parameters, place, findings)
        else:
            hint = did_you_mean(said.job, jobs) or f", there is {', '.join(sorted(jobs))}"
            findings.add((*place, "job"), f"there is no job '{said.job}'{hint}")
        found[name] = Recipe(job=said.job, number=said.number, parameters=parameters)
    return found


def _check_parameters(
    raw: Mapping[str, Any],
    job: Any,
    name: str,
    parameters: Mapping[str, Any],
    place: tuple[str, str],
    findings: Findings,
) -> None:
    """Whether the job takes them."""
    given = with_sections(raw, job, name, parameters)
    try:
        job.Config.model_validate_json(to_json(given), strict=True)
    except ValidationError as exc:
        findings.add_validation(place, given, job.Config, exc)


def with_sections(
    raw: Mapping[str, Any], job: Any, name: str, parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """What a start of the job is given: ``parameters`` over its own section and what it has from those of
    others, without the keys that every job has."""
    sections = tables(raw.get("job"))
    inherited = {
        key: sections[other.name][key]
        for other, keys in getattr(job, "inherits", {}).items()
        for key in keys
        if key in sections.get(other.name, {})
    }
    given = {**inherited, **sections.get(name, {}), **parameters}
    return {key: value for key, value in given.items() if key not in ("tool", "procedure")}
