"""Jobs of other packages: by ``package.module:Class``, or by an entry point of ``cellward.procedures``."""

import inspect
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from pydantic import BaseModel

from cell.procedure import Procedure
from procedures.kind import add_outside

GROUP = "cellward.procedures"
HIGHEST_NUMBER = 65535  # a Modbus register holds it


def installed_jobs() -> dict[str, str]:
    """``package.module:Class`` of each job that an installed package offers, by the job's name."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP)}


def job_class(name: str, reference: str, jobs: Mapping[str, Any]) -> type[Procedure]:
    """The class of the job ``name``; ``jobs`` are those that there are without it.

    ``LookupError`` with a sentence when it cannot be imported, is no job, has another name, or has a
    number or a kind that it cannot have.
    """
    module, colon, attribute = reference.partition(":")
    if not (colon and module and attribute):
        raise LookupError(f"should be \"package.module:Class\", not '{reference}'")
    try:
        found = getattr(import_module(module), attribute)
    except Exception as exc:  # whatever another package does while it is imported
        raise LookupError(f"job '{reference}' cannot be loaded: {exc}") from exc
    if not (isinstance(found, type) and issubclass(found, Procedure)) or inspect.isabstract(found):
        raise LookupError(f"'{reference}' is no job: no class that completes cell.procedure.Procedure")
    if missing := [key for key in _REQUIRED if not hasattr(found, key)]:
        raise LookupError(f"job '{reference}' lacks {', '.join(missing)}")
    if not (isinstance(found.Config, type) and issubclass(found.Config, BaseModel)):
        raise LookupError(f"job '{reference}' has no Config model, so it is no job")
    if found.name != name:
        raise LookupError(f"the job of '{reference}' is called '{found.name}'; write [job.{found.name}]")
    if "tool" in found.Config.model_fields:
        raise LookupError(f"job '{reference}': every job has the key 'tool', so its Config must call it else")
    _check_number(found, reference, jobs)
    try:
        add_outside(found.kind)
    except LookupError as exc:
        raise LookupError(f"job '{reference}': {exc.args[0]}") from exc
    return found


_REQUIRED = ("name", "number", "Config", "State", "TRANSITIONS", "CHECKPOINTS")


def _check_number(job: type[Procedure], reference: str, jobs: Mapping[str, Any]) -> None:
    number: Any = job.number
    if type(number) is not int or not 0 < number <= HIGHEST_NUMBER:
        raise LookupError(f"job '{reference}' needs a number of 1 to {HIGHEST_NUMBER}, not {number!r}")
    for other in jobs.values():
        if other is not job and getattr(other, "number", None) == number:
            raise LookupError(f"job '{reference}' has the number {number}, which is that of '{other.name}'")
