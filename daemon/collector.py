"""When garbage is collected: never for long while the arm may move.

A collection of all that lives takes tens of milliseconds, in which the loop stands still. What start-up made
is frozen, the automatic collections look at young objects only, and the whole is collected while no job runs.

Young objects are counted as those made less those freed, whatever their age. Buffers of samples free an old
one for each new one, so there are several times as many to look at when the count is reached
(``python -m bench.lateness`` shows how late the loop is).
"""

import asyncio
import gc
from collections.abc import Callable

YOUNG = 1_000  # more objects made than freed between two collections of the young ones
MIDDLE = 2  # of those, between two of the middle generation
NEVER = 1_000_000_000
PERIOD_S = 30.0


def freeze_start_up() -> None:
    """What lives now lives to the end: nobody has to look at it again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(YOUNG, MIDDLE, NEVER)


async def collect_at_rest(busy: Callable[[], bool], period_s: float = PERIOD_S) -> None:
    """Collect everything now and then, for ever, when no job runs."""
    while True:
        await asyncio.sleep(period_s)
        if not busy():
            gc.collect()
