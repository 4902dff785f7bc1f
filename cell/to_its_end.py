"""Work that a cancel does not cut short."""

import asyncio
from collections.abc import Coroutine
from typing import Any


async def run_to_its_end(work: Coroutine[Any, Any, None]) -> None:
    """Await ``work`` however often we are cancelled meanwhile; the cancel is raised afterwards.

    A plain ``finally: await stop()`` does not survive a second cancel; stopping an arm must.
    """
    task = asyncio.create_task(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError as cancel:
            cancelled = cancel
    failure = None if task.cancelled() else task.exception()
    if failure is not None:
        raise failure
    if cancelled is not None:
        raise cancelled
