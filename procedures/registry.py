"""Every job by name: the shipped ones, those of installed packages, and those that a configuration names."""

from cell.procedure import Procedure
from procedures.kind import KINDS, load
from procedures.outside import installed_jobs, job_class

SHIPPED: dict[str, type[Procedure]] = {j.name: j for kind in KINDS.values() for j in map(load, kind.jobs)}
JOBS: dict[str, type[Procedure]] = dict(SHIPPED)
UNUSABLE: dict[str, str] = {}  # why a job of an installed package cannot be used


def _add_installed() -> None:
    for name, reference in sorted(installed_jobs().items()):
        try:
            if name in SHIPPED:
                raise LookupError(f"'{reference}' has the name of a shipped job, '{name}'")
            JOBS[name] = job_class(name, reference, JOBS)
        except LookupError as exc:
            UNUSABLE[name] = str(exc.args[0])


_add_installed()
