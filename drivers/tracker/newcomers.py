"""The samples of a stream that are taken after a moment, one by one, while its link is good."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, Generic, TypeVar

from cell.samples import Sample, Stream
from drivers.life import Life

T = TypeVar("T")


class Newcomers(Generic[T]):
    """What :func:`newcomers` gives."""

    def __init__(self, life: Life, lost: asyncio.Task[Exception], after: float) -> None:
        self._life, self._lost, self._after = life, lost, after
        self._queue: asyncio.Queue[Sample[T]] = asyncio.Queue()

    async def next(self, timeout: float) -> Sample[T] | None:
        """The next sample, None when none came in ``timeout`` s; what broke the link."""
        get = asyncio.create_task(self._queue.get())
        waiting: list[asyncio.Task[Any]] = [get, self._lost]
        try:
            await asyncio.wait(waiting, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
            if get.done():
                return get.result()
            self._life.require()
            return None
        finally:
            get.cancel()

    def take(self, sample: Sample[T]) -> None:
        if sample.t - sample.dt >= self._after:
            self._queue.put_nowait(sample)


@asynccontextmanager
async def newcomers(stream: Stream[T], life: Life, after: float) -> AsyncIterator[Newcomers[T]]:
    """Samples that were taken wholly after ``after``."""
    lost = asyncio.create_task(life.wait_lost())
    found: Newcomers[T] = Newcomers(life, lost, after)
    undo = stream.subscribe(found.take)
    try:
        yield found
    finally:
        undo()
        lost.cancel()
        await asyncio.wait([lost])
