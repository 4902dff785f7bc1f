"""Every job by name."""

from cell.procedure import Procedure
from procedures.kind import KINDS, load

JOBS: dict[str, type[Procedure]] = {job.name: job for kind in KINDS.values() for job in map(load, kind.jobs)}
