"""Which earlier run a new one may go on from: one of the same job under the same conditions."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.store.runs import load_run

SAME = ("config", "job_config", "values", "identities")


def adoptable(runs: Path, run_id: int | None, job: str, conditions: Mapping[str, Any]) -> Path | None:
    """The folder of an earlier run whose finished poses may be taken over; None when none is wanted.

    ``NOT_FOUND``; ``IDENTITY_DIFFERS`` for a run of another job, or under other ``conditions``.
    """
    if run_id is None:
        return None
    old = load_run(runs, run_id)
    if old.job != job:
        raise error("IDENTITY_DIFFERS", f"run {run_id} was a {old.job}, not a {job}")
    for key in SAME:
        if old.info.get(key) != conditions[key]:
            raise error("IDENTITY_DIFFERS", f"'{key}' of run {run_id} is not what it is now")
    return old.path
