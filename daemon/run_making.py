"""A run comes into being whole, with its folder and its line in the ledger, or it is withdrawn.

What is written is written in a thread that nobody can cancel. Who is cancelled meanwhile waits for it, and
takes back what it has made.
"""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from cell.clock import Clock
from cell.errors import CellError
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from cell.to_its_end import run_to_its_end

WITHDRAWN = "withdrawn"


async def make_run(
    runs: Path,
    ledger: Ledger,
    job: str,
    conditions: Mapping[str, Any],
    clock: Clock,
    started_by: tuple[str, str] | None,
    tool: str | None,
) -> RunFolder:
    """The folder of a new run; ``started_by`` is who and on which channel, None for a run that only plans.

    ``tool`` is the name of what is on the flange, None where that plays no part.
    """

    def make() -> RunFolder:
        folder = RunFolder.create(runs, job, ledger.next_run_id(), conditions, clock)
        if started_by is not None:
            try:
                ledger.start_run(folder.run_id, job, folder.path.name, *started_by, tool)
            except BaseException:
                _withdraw(folder, ledger)
                raise
        return folder

    async def take_back() -> None:
        with suppress(Exception):  # what failed has left nothing behind
            folder = await making
            await asyncio.to_thread(_withdraw, folder, ledger)

    making = asyncio.create_task(asyncio.to_thread(make))
    try:
        return await asyncio.shield(making)
    except asyncio.CancelledError:
        await run_to_its_end(take_back())
        raise


async def withdraw_run(folder: RunFolder, ledger: Ledger) -> None:
    """End a run that never began, however often we are cancelled meanwhile."""
    await run_to_its_end(asyncio.to_thread(_withdraw, folder, ledger))


def _withdraw(folder: RunFolder, ledger: Ledger) -> None:
    """Its end, as far as the disk takes it: the next start writes what is missing."""
    end = {"outcome": WITHDRAWN, "packml": None, "verdict": None, "error": None}
    with suppress(CellError):
        folder.note("state", terminal=True, **end)
    with suppress(CellError):
        folder.finish(end)
    with suppress(CellError):
        ledger.end_run(folder.run_id, WITHDRAWN, None)
