"""A process for what somebody who looks at the page asks, behind everything else and apart from the jobs."""

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

from daemon.worker import ProcessWorker

R = TypeVar("R")

NICENESS = 19
IDLE_S = 60.0  # somebody who reads one card after the other does not wait for a new process each time
LONGEST_S = 60.0


class SpareWorker:
    """Starts its process when it is asked, and ends it when nobody has asked for a while.

    A call that takes longer than ``longest_s`` is a ``TimeoutError``, and its process ends.
    """

    def __init__(
        self,
        make: Callable[[], ProcessWorker] = lambda: ProcessWorker(NICENESS),
        idle_s: float = IDLE_S,
        longest_s: float = LONGEST_S,
    ) -> None:
        self._make, self._idle_s, self._longest_s = make, idle_s, longest_s
        self._worker: ProcessWorker | None = None
        self._one_at_a_time = asyncio.Lock()
        self._ending: asyncio.Task[None] | None = None

    async def call(self, fn: Callable[..., R], *args: Any, **kwargs: Any) -> R:
        async with self._one_at_a_time:
            await self._keep()
            self._worker = self._worker or self._make()
            try:
                async with asyncio.timeout(self._longest_s):
                    return await self._worker.call(fn, *args, **kwargs)
            finally:
                self._ending = asyncio.create_task(self._end_when_idle(), name="spare worker")

    async def stop(self) -> None:
        async with self._one_at_a_time:
            await self._keep()
            await self._end()

    async def _keep(self) -> None:
        ending, self._ending = self._ending, None
        if ending is not None:
            ending.cancel()
            await asyncio.wait([ending])

    async def _end_when_idle(self) -> None:
        await asyncio.sleep(self._idle_s)
        await self._end()

    async def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            await worker.stop()
