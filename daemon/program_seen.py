"""Whether the arm's controller shows that a program runs, and a stop that is over when it shows none."""

import asyncio
from contextlib import suppress
from typing import Self

from cell.clock import Clock
from cell.devices import Arm, ArmState
from cell.errors import CellError
from cell.motion import MAX_STATE_AGE_S
from cell.samples import Sample

SEEN_S = 5.0  # a controller shows so soon that the program runs
STOP_S = 2.0
SETTLES_S = 0.5  # so soon after a stop the states show it
STOPPED_WITHIN_S = 10.0  # or it is told that it may run; the daemon's end waits for it


class ProgramSeen:
    """Whether the arm shows a program that runs, while the block lasts."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.seen = asyncio.Event()  # a state with one has come

    async def __aenter__(self) -> Self:
        self._unsubscribe = self._arm.state.subscribe(self._look)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._unsubscribe()

    async def seen_within(self, timeout: float) -> bool:
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                await self.seen.wait()
        return self.seen.is_set()

    @property
    def now(self) -> bool | None:
        """None while the arm gives no fresh state."""
        try:
            return bool(self._arm.state.latest(MAX_STATE_AGE_S).value.program_running)
        except CellError:
            return None

    def _look(self, sample: Sample[ArmState]) -> None:
        if sample.value.program_running:
            self.seen.set()


async def stop_until_seen(arm: Arm, clock: Clock) -> str:
    """Stop a program that may have been started, and again while one runs: a late start is overtaken.

    What became of it, in words.
    """
    give_up = clock.now() + STOPPED_WITHIN_S
    async with ProgramSeen(arm) as running:
        while True:
            failure = await _stop(arm)
            await clock.sleep(SETTLES_S)  # until then the states may still show what was stopped
            running.seen.clear()
            if failure is None and not running.now and not await running.seen_within(SEEN_S):
                break
            if clock.now() > give_up:
                break
        still = running.now
    if failure is not None:
        return f"the stop of the arm's program failed ({failure}): look at the arm, it may run"
    if still is not False:
        known = "runs though it was told to stop" if still else "is not seen"
        return f"the arm's program {known}: look at the arm"
    return "the arm's program was stopped"


async def _stop(arm: Arm) -> Exception | None:
    """Stop what runs on the arm; why it could not be told."""
    try:
        async with asyncio.timeout(STOP_S):
            await arm.stop_program()
    except Exception as exc:
        return exc
    return None
