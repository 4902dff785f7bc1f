"""Waiting for the end of a program on the arm."""

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
