"""The samples of a stream that are taken after a moment, one by one, while its link is good."""

import asyncio
from collections.abc import Callable
from typing import Any, Generic, Self, TypeVar

from cell.samples import Sample, Stream
from drivers.life import Life

T = TypeVar("T")


class Newcomers(Generic[T]):
    """``async with Newcomers(stream, life, after)``: samples that were taken wholly after ``after``."""

    def __init__(self, stream: Stream[T], life: Life, after: float) -> None:
        self._stream, self._life, self._after = stream, life, after
        self._queue: asyncio.Queue[Sample[T]] = asyncio.Queue()
        self._undo: Callable[[], None] = lambda: None
        self._lost: asyncio.Task[Exception] | None = None

    async def __aenter__(self) -> Self:
        self._undo = self._stream.subscribe(self._take)
        self._lost = asyncio.create_task(self._life.wait_lost())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._undo()
        if self._lost is not None:
            self._lost.cancel()
            await asyncio.wait([self._lost])

    async def next(self, timeout: float) -> Sample[T] | None:
        """The next sample, None when none came in ``timeout`` s; what broke the link."""
        assert self._lost is not None
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

    def _take(self, sample: Sample[T]) -> None:
        if sample.t - sample.dt >= self._after:
            self._queue.put_nowait(sample)
