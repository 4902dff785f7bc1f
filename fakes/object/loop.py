"""An asyncio loop on virtual time: it never waits for a timer, it jumps to it.

While work runs outside the loop (``run_in_executor``, ``to_thread``, worker processes reached that way, or a
block under :meth:`VirtualTimeLoop.outside`) time stands still and the loop really waits for it. So a run is
a function of its inputs, however busy the machine is.
"""

import asyncio
import selectors
from collections.abc import Callable, Coroutine, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any, TypeVar, TypeVarTuple

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

_SELDOM = 64  # so many turns of the loop are made without a look at its own wake-up pipe


class DeadlockError(RuntimeError):
    """Every task waits for something that nothing can bring about."""


class _JumpingSelector(selectors.BaseSelector):
    """A real selector whose idle waits move a virtual clock instead of taking time."""

    def __init__(self) -> None:
        self._real = selectors.DefaultSelector()
        self.now = 0.0
        self.outside = 0
        self.own_fds = 0  # the loop's own wake-up pipe is no source of events
        self._unlooked = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        events = self._look(timeout)
        if events or (timeout is not None and timeout <= 0):
            return events
        if self.outside:
            return self._real.select(None)
        if timeout is not None:
            self.now += timeout
            return []
        if len(self._real.get_map()) <= self.own_fds:
            raise DeadlockError("nothing is scheduled, and no file or executor job can wake the loop")
        return self._real.select(None)

    def _look(self, timeout: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        """What is ready now. Where only the loop's own pipe could be, the question is seldom put to the
        system: what a thread hands over is seen at the next turn without it, and signals can wait so long."""
        alone = timeout is not None and not self.outside and len(self._real.get_map()) <= self.own_fds
        if alone and self._unlooked < _SELDOM:
            self._unlooked += 1
            return []
        self._unlooked = 0
        return self._real.select(0)

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.register(fileobj, events, data)

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._real.unregister(fileobj)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.modify(fileobj, events, data)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._real.get_map()

    def close(self) -> None:
        self._real.close()


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """``time()`` starts at 0 and moves only when nothing else is left to do."""

    def __init__(self) -> None:
        self._jumping = _JumpingSelector()
        super().__init__(self._jumping)
        self._jumping.own_fds = len(self._jumping.get_map())

    def time(self) -> float:
        return self._jumping.now

    @contextmanager
    def outside(self) -> Iterator[None]:
        """Hold time still for the block: somebody outside the loop is going to wake it."""
        self._jumping.outside += 1
        try:
            yield
        finally:
            self._jumping.outside -= 1

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[*Ts], T], *args: *Ts
    ) -> asyncio.Future[T]:
        future = super().run_in_executor(executor, func, *args)
        self._jumping.outside += 1
        future.add_done_callback(self._came_back)
        return future

    async def shutdown_default_executor(self, *timeout: float | None) -> None:  # Python 3.12 gives a timeout
        with self.outside():
            await super().shutdown_default_executor(*timeout)

    def _came_back(self, _future: asyncio.Future[Any]) -> None:
        self._jumping.outside -= 1


def run_virtual(main: Coroutine[Any, Any, T], limit_s: float = 24 * 3600.0) -> T:
    """``asyncio.run`` on a fresh virtual loop; ``TimeoutError`` after ``limit_s`` virtual seconds."""

    async def limited() -> T:
        async with asyncio.timeout(limit_s):
            return await main

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(limited())
