"""Whether the arm can be moved by a job that begins: its state is fresh, and no program of its own runs."""

from contextlib import suppress

from cell.clock import Clock
from cell.devices import Arm
from cell.errors import CellError

FRESH_WITHIN_S = 0.5
ASKED_BY_S = 0.5  # a program that asks for a job as its last act has so long to end
LOOK_S = 0.02


async def require_movable(arm: Arm, clock: Clock, patience_s: float = 0.0) -> None:
    """What :meth:`cell.devices.Arm.check_movable` refuses with; ``ARM_PROGRAM_RUNNING`` after that time."""
    with suppress(CellError):  # a pause of a moment refuses no start; the check tells all else
        await arm.wait_fresh(FRESH_WITHIN_S)
    end = clock.now() + patience_s
    while True:
        try:
            return arm.check_movable()
        except CellError as refusal:
            if refusal.name != "ARM_PROGRAM_RUNNING" or clock.now() >= end:
                raise
        await clock.sleep(LOOK_S)
