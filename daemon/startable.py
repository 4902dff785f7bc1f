"""What somebody may start: the jobs and the recipes of the cell, each with the tools that it may be given."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from annotated_types import Ge, Le

from cell.errors import CellError
from cell.procedure import Procedure
from daemon.config import CellConfig
from daemon.job_arguments import arguments_of
from daemon.job_config import make_procedure
from daemon.tools import ARGUMENT, tool_names, usual_tool


@dataclass(frozen=True)
class Choice:
    """A parameter that somebody may give with a start: one of ``words``, or a number between the bounds.

    ``value`` is what a start that does not give it has, and ``meaning`` tells what it is.
    """

    key: str
    value: str | float
    meaning: str
    words: tuple[str, ...]
    least: float | None
    most: float | None


@dataclass(frozen=True)
class Startable:
    """A job or a recipe by its ``name``; ``number`` is a PLC's, None for a recipe without one.

    ``tools`` are those to choose from, none where there is no choice; ``tool`` is the one of a start that
    names none, None where it has to. ``choices`` are what a PLC could give as arguments, without what the
    recipe has settled; none where the job cannot be started.
    """

    name: str
    job: str
    number: int | None
    recipe: bool
    tools: tuple[str, ...]
    tool: str | None
    choices: tuple[Choice, ...] = ()


def startables(config: CellConfig, jobs: Mapping[str, type[Procedure]]) -> list[Startable]:
    """The jobs in the order of their numbers, then the recipes as they are written."""
    found = []
    for name, job in sorted(jobs.items(), key=lambda entry: entry[1].number):
        choices = _choices(config, job, {})
        found.append(Startable(name, name, job.number, False, *_tools(config, job), choices))
    for name, recipe in config.recipe.items():
        tools, usual = _tools(config, jobs[recipe.job])
        own = recipe.parameters.get(ARGUMENT)
        choices = _choices(config, jobs[recipe.job], recipe.parameters)
        found.append(Startable(name, recipe.job, recipe.number, True, tools, own or usual, choices))
    return found


def _choices(config: CellConfig, job: type[Procedure], settled: Mapping[str, Any]) -> tuple[Choice, ...]:
    try:
        section = make_procedure(job, config, {}, settled).config
    except CellError:
        return ()
    found = []
    for argument in arguments_of(job):
        if argument.key in settled:
            continue
        field = job.Config.model_fields[argument.key]
        least, most = _bound(field.metadata, Ge, "ge"), _bound(field.metadata, Le, "le")
        value, meaning = getattr(section, argument.key), field.description or ""
        found.append(Choice(argument.key, value, meaning, argument.words, least, most))
    return tuple(found)


def _bound(metadata: list[Any], kind: type, name: str) -> float | None:
    """The number of the first bound of its kind, as pydantic keeps it of a field."""
    return next((getattr(bound, name) for bound in metadata if isinstance(bound, kind)), None)


def _tools(config: CellConfig, job: type[Procedure]) -> tuple[tuple[str, ...], str | None]:
    names, usual = tool_names(config), usual_tool(config, job.name)
    chosen = len(names) > 1 and _moves_the_arm(config, job)
    return tuple(names) if chosen else (), None if usual is None else usual.name


def _moves_the_arm(config: CellConfig, job: type[Procedure]) -> bool:
    try:
        return "arm" in make_procedure(job, config, {}).uses()
    except CellError:  # a job without the section that it needs cannot be started at all
        return False
