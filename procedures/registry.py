"""Every job by name."""

from cell.procedure import Procedure
from procedures.cone_capture import ConeCapture

JOBS: dict[str, type[Procedure]] = {job.name: job for job in (ConeCapture,)}
