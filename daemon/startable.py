"""What somebody may start: the jobs and the recipes of the cell, each with the tools that it may be given."""

from collections.abc import Mapping
from dataclasses import dataclass

from cell.errors import CellError
from cell.procedure import Procedure
from daemon.config import CellConfig
from daemon.job_config import make_procedure
from daemon.tools import ARGUMENT, tool_names, usual_tool


@dataclass(frozen=True)
class Startable:
    """A job or a recipe by its ``name``; ``number`` is a PLC's, None for a recipe without one.

    ``tools`` are those to choose from, none where there is no choice; ``tool`` is the one of a start that
    names none, None where it has to.
    """

    name: str
    job: str
    number: int | None
    recipe: bool
    tools: tuple[str, ...]
    tool: str | None


def startables(config: CellConfig, jobs: Mapping[str, type[Procedure]]) -> list[Startable]:
    """The jobs in the order of their numbers, then the recipes as they are written."""
    found = []
    for name, job in sorted(jobs.items(), key=lambda entry: entry[1].number):
        found.append(Startable(name, name, job.number, False, *_tools(config, job)))
    for name, recipe in config.recipe.items():
        tools, usual = _tools(config, jobs[recipe.job])
        own = recipe.parameters.get(ARGUMENT)
        found.append(Startable(name, recipe.job, recipe.number, True, tools, own or usual))
    return found


def _tools(config: CellConfig, job: type[Procedure]) -> tuple[tuple[str, ...], str | None]:
    names, usual = tool_names(config), usual_tool(config, job.name)
    chosen = len(names) > 1 and _moves_the_arm(config, job)
    return tuple(names) if chosen else (), None if usual is None else usual.name


def _moves_the_arm(config: CellConfig, job: type[Procedure]) -> bool:
    try:
        return "arm" in make_procedure(job, config, {}).uses()
    except CellError:  # a job without the section that it needs cannot be started at all
        return False
