"""A run's data solved and judged again as the job did it: the same files, limits and values."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.formats.result import Envelope
from procedures.documents import kind_named
from procedures.registry import JOBS


def solve_again(job: str, folder: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
    """The result of a run from its folder; ``info`` is its ``run.json``, ``recorded`` its result.

    ``NOT_FOUND`` when the run has no data set, or its job none at all.
    """
    if job not in JOBS:
        raise error(
            "NOT_FOUND",
            f"{folder.name}: there is no job '{job}' here; install its package, or name the job in "
            f"[job.{job}] procedure of the cell.toml",
        )
    name = kind_named(JOBS[job].kind).data_file
    if not name:
        raise error("NOT_FOUND", f"{folder.name}: the job {job} keeps no data set, so it cannot be replayed")
    if not (folder / name).exists():
        raise error("NOT_FOUND", f"{folder.name} ({job}) has no {name} to solve")
    return JOBS[job].solve_again(folder / name, info, recorded)
