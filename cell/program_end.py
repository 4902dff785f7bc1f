"""The end of a program on the arm, and whether another one began after it."""

import asyncio

from cell.devices import Arm, ArmState
from cell.samples import Sample


async def program_ended(arm: Arm, timeout: float) -> bool:
    """True once a sample shows that no program runs; the newest one counts."""
    newest = arm.state.last()
    if newest is not None and not newest.value.program_running:
        return True
    ended = asyncio.Event()

    def look(sample: Sample[ArmState]) -> None:
        if not sample.value.program_running:
            ended.set()

    unsubscribe = arm.state.subscribe(look)
    try:
        async with asyncio.timeout(timeout):
            await ended.wait()
        return True
    except TimeoutError:
        return False
    finally:
        unsubscribe()


class ProgramWatch:
    """Whether a program ``began`` on an arm that was seen without one, from the beginning of the watch on."""

    def __init__(self, arm: Arm) -> None:
        newest = arm.state.last()
        self._none_ran = newest is not None and not newest.value.program_running
        self.began = False
        self._undo = arm.state.subscribe(self._look)

    def _look(self, sample: Sample[ArmState]) -> None:
        if not sample.value.program_running:
            self._none_ran = True
        elif self._none_ran:
            self.began = True

    def close(self) -> None:
        """End the watch."""
        self._undo()
