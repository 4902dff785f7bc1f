"""The folder in which a daemon keeps its runs and its ledger: made, writable, and held by one daemon."""

import fcntl
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cell.clock import Clock
from cell.errors import CellError, error
from cell.store.files import disk_errors
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder, interrupted_runs, load_run

log = logging.getLogger("cellward")

FOLDER_LOOK_S = 0.5


def make_state_folder(state: Path) -> None:
    """``state`` with its folder ``runs``; ``DISK_FULL`` or ``DISK_FAILED`` name what cannot be made."""
    with disk_errors(state / "runs"):
        (state / "runs").mkdir(parents=True, exist_ok=True)


@contextmanager
def claimed(state: Path) -> Iterator[None]:
    """Hold the state folder; ``DAEMON_RUNNING`` when another daemon does, ``DISK_FAILED`` when it cannot be
    written.

    A second one would take the running job of the first for an interrupted one, and write its end.
    """
    path = state / "lock"
    with disk_errors(path):
        file = path.open("w", encoding="utf-8")
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the kernel lets go when this process ends
        except BlockingIOError:
            raise error("DAEMON_RUNNING", f"one keeps its state in {state}") from None
        yield


def end_interrupted(runs: Path, ledger: Ledger) -> list[int]:
    """Write the end that a killed daemon could not, for each run without one; returns their numbers.

    A run whose end cannot be written (a damaged folder, a full disk) is logged and keeps no daemon down: the
    next start tries again.
    """
    found = []
    for run in interrupted_runs(runs):
        log.warning(
            "run %d (%s) was interrupted; nothing moves by itself. 'cellward adopt %d' takes it up again",
            run.run_id,
            run.job,
            run.run_id,
        )
        found.append(run.run_id)
        try:
            end = run.mark_interrupted()
            ledger.end_run(run.run_id, str(end["outcome"]), end.get("verdict"))
        except CellError as exc:
            log.error("the end of run %d cannot be written, the next start tries again: %s", run.run_id, exc)
    _end_in_the_ledger(runs, ledger)
    return found


def _end_in_the_ledger(runs: Path, ledger: Ledger) -> None:
    """A kill between the end in the folder and that in the ledger leaves a run open there.

    A run whose folder is gone is ended as interrupted: nothing will tell more.
    """
    for run_id in ledger.open_runs():
        try:
            end = load_run(runs, run_id).read_end()
            if end is not None:
                ledger.end_run(run_id, str(end["outcome"]), end.get("verdict"))
        except CellError as exc:
            if exc.name == "NOT_FOUND":
                ledger.end_run(run_id, "interrupted", None)
                continue
            log.error("the ledger does not know the end of run %d: %s", run_id, exc)


def damage_text(damage: Mapping[str, Any]) -> str:
    """What became of a ledger that was damaged or missing, in one sentence."""
    if why := damage.get("still_open"):
        return (
            f"the ledger is damaged ({why}); start the daemon anew: it keeps the file and brings the "
            "committed calibrations back"
        )
    if damage.get("aside") is None:
        begun = "the ledger was missing, and a new one was begun"
    else:
        begun = f"the ledger was damaged; it is kept as {damage['aside']} and a new one was begun"
    restored = ", ".join(f"{name} version {v}" for name, v in (damage.get("restored") or {}).items())
    why_not = damage.get("why_not")
    if why_not and not restored:
        return f"{begun}; no calibration came back, for {why_not}: the configured values are in effect"
    if why_not:
        return f"{begun}; from the copy came back {restored}, but {why_not}"
    return f"{begun}; from the copy came back {restored or 'nothing, for nothing was committed'}"


async def folder_lost(folder: RunFolder, clock: Clock) -> CellError:
    """Block until the folder of a run is removed or moved: what is measured then, has no record."""
    while True:
        await clock.sleep(FOLDER_LOOK_S)
        try:
            folder.check_on_disk()
        except CellError as lost:
            return lost
