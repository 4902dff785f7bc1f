"""Reports that are drawn behind everything else.

Of a run without a result when it ends, and of any run again when somebody decided about it or signed it.
Each is drawn by a process of its own, for the worker has to be free when the next job plans or solves. A
report that is not drawn costs nothing: ``cellward report`` draws it when it is asked for.
"""

import asyncio
import logging
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.priority import yield_to_others
from cell.store.ledger import Ledger

log = logging.getLogger("cellward.results")

NICENESS = 19
TIMEOUT_S = 120.0  # on a machine that is busy with the next job
MAX_WAITING = 20


class ReportDrawing:
    """Draws one after the other; ``want`` returns at once."""

    def __init__(self) -> None:
        self._waiting: asyncio.Queue[Path] = asyncio.Queue(MAX_WAITING)

    def want(self, folder: Path) -> None:
        """Draw the report of a run folder that has its end."""
        if self._waiting.full():
            log.warning("too many reports wait; 'cellward report' draws that of %s", folder.name)
            return
        self._waiting.put_nowait(folder)

    async def run(self) -> None:
        """Draw what is wanted until cancelled; a drawing that is under way then is given up."""
        while True:
            folder = await self._waiting.get()
            try:
                async with asyncio.timeout(TIMEOUT_S):
                    why = await _draw(folder)
            except (TimeoutError, OSError) as exc:
                why = str(exc) or f"not within {TIMEOUT_S:g} s"
            if why:
                log.warning("the report of %s was not drawn: %s", folder.name, why)


async def _draw(folder: Path) -> str:
    """Why the report could not be drawn; empty when it was."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-P",  # a folder with another "daemon" to start in must not shadow ours
        "-m",
        "daemon.report_drawing",
        str(folder),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        _, told = await process.communicate()
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
    lines = told.decode("utf-8", "replace").strip().splitlines()
    return "" if process.returncode == 0 else (lines[-1] if lines else f"exit code {process.returncode}")


def main(folder: Path) -> int:
    """Draw one report."""
    yield_to_others(NICENESS)
    from procedures.report.failed import write_failed_report
    from procedures.report.write import write_report

    try:
        if (folder / "result.json").exists():
            write_report(folder, decided=_decided(folder))
        else:
            write_failed_report(folder)
    except CellError as exc:
        sys.stderr.write(f"{exc}\n")
        return 1
    return 0


def _decided(folder: Path) -> list[dict[str, Any]]:
    """What became of the run's results, by the ledger of its cell."""
    with closing(Ledger(folder.parent.parent / "ledger.sqlite", read_only=True)) as ledger:
        return ledger.decisions_on(int(folder.name.rpartition("_")[2]))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
