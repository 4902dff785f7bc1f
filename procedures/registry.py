"""Every job by name: the shipped ones, those of installed packages, and those that a configuration names."""

from collections.abc import Mapping
from typing import Any

from cell.collector import without_collector
from cell.procedure import Procedure
from procedures.kind import KINDS, load
from procedures.outside import installed_jobs, job_class

with without_collector():  # most of what the program consists of
    _SHIPPED = [load(job) for kind in KINDS.values() for job in kind.jobs]

SHIPPED: dict[str, type[Procedure]] = {job.name: job for job in _SHIPPED}
JOBS: dict[str, type[Procedure]] = dict(SHIPPED)
UNUSABLE: dict[str, str] = {}  # why a job of an installed package cannot be used
CONFIGURED: dict[str, str] = {}  # "package.module:Class" of the jobs that a configuration names


def add_configured(name: str, reference: str, others: Mapping[str, Any] | None = None) -> type[Procedure]:
    """Make what ``[job.NAME] procedure`` names a job of this process; ``others`` are jobs beside ours.

    ``LookupError`` as of :func:`procedures.outside.job_class`.
    """
    jobs = {key: job for key, job in {**JOBS, **(others or {})}.items() if key != name}
    job = job_class(name, reference, jobs)
    JOBS[name], CONFIGURED[name] = job, reference
    return job


def _add_installed() -> None:
    for name, reference in sorted(installed_jobs().items()):
        try:
            if name in SHIPPED:
                raise LookupError(f"'{reference}' has the name of a shipped job, '{name}'")
            JOBS[name] = job_class(name, reference, JOBS)
        except LookupError as exc:
            UNUSABLE[name] = str(exc.args[0])


_add_installed()
