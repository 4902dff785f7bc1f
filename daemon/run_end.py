"""The end of a run: its one terminal line, its last file, and what status and registers keep of it."""

import asyncio
import logging
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from cell.errors import CellError, error
from cell.procedure import Run
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from daemon.stored_result import kept_of

log = logging.getLogger("cellward.run_end")


async def write_end(run: Run, folder: RunFolder, ledger: Ledger, end: Mapping[str, Any]) -> CellError | None:
    """The terminal line of the journal, ``end.json`` and the ledger's row; why one could not be written.

    What could not be written here is written by the next start, which finds no ``end.json``.
    """
    try:
        run.note("state", terminal=True, **end)
        await asyncio.to_thread(folder.finish, end)
        await asyncio.to_thread(ledger.end_run, run.id, end["outcome"], end["verdict"])
        return None
    except Exception as exc:
        log.error("the end of run %d could not be written: %s", run.id, exc)
        coded = exc if isinstance(exc, CellError) else error("INTERNAL", f"{type(exc).__name__}: {exc}")
        if coded.name == "RUN_FOLDER_LOST":  # there is nothing left that a start could find
            with suppress(CellError):
                await asyncio.to_thread(ledger.end_run, run.id, end["outcome"], end["verdict"])
        return coded


def main_figure_of(run: Run) -> dict[str, Any] | None:
    """What a list of runs shows of the result, as ``end.json`` has it; a kind that cannot say it has none."""
    try:
        figure = run.result.main_figure() if run.result is not None else None
    except Exception:  # of a kind of another package: it must not cost the end of the run
        log.exception("run %d has no main figure", run.id)
        return None
    return None if figure is None else asdict(figure)


def keep_shown(run: Run) -> None:
    """What registers and status show of a result that was not stored, as its run was stopped before."""
    if run.result is None or run.shown is not None:
        return
    try:
        kept = kept_of(run.result, f"the result of run {run.id}")
    except Exception:  # of a kind of another package: the next run must be able to start
        log.exception("the result of run %d cannot be shown", run.id)
        return
    if kept.misfit is not None:
        log.error("registers show nothing of the result: %s", kept.misfit)
    run.figures, run.shown = kept.figures, kept.shown


def failure_of(job: asyncio.Task[None]) -> CellError | None:
    """The coded error that ended a job; None when it returned or was cancelled on request."""
    if job.cancelled() or (exc := job.exception()) is None:
        return None
    if isinstance(exc, CellError):
        return exc
    log.error("a job failed in an unexpected way", exc_info=exc)
    return error("INTERNAL", f"{type(exc).__name__}: {exc}")
