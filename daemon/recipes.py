"""Recipes: a start that names one is a start of its job with its arguments."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from daemon.config import CellConfig
from daemon.start_request import StartRequest


def with_recipe(config: CellConfig, request: StartRequest) -> StartRequest:
    """``request`` with the job of the recipe that it names; any other is as it was."""
    recipe = config.recipe.get(request.job)
    return request if recipe is None else replace(request, job=recipe.job, recipe=request.job)


def arguments_of_recipe(config: CellConfig, request: StartRequest) -> Mapping[str, Any]:
    """What the recipe of ``request`` gives; nothing for a job alone."""
    return config.recipe[request.recipe].parameters if request.recipe else {}


def place_of(config: CellConfig, recipe: str | None, job: str, key: str) -> str:
    """The section that the ``key`` of a start is from: the recipe that it names, if that has it, else the
    job's."""
    own = recipe and key in config.recipe[recipe].parameters
    return f"recipe.{recipe}" if own else f"job.{job}"


def recipes_by_number(config: CellConfig) -> dict[int, str]:
    """The recipes that a PLC can start, by their number."""
    return {recipe.number: name for name, recipe in config.recipe.items() if recipe.number is not None}
