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
from contextvars import Context, copy_context
from math import inf
from typing import Any, TypeVar, TypeVarTuple

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

_RESOLUTION_S = 1e-9  # what is due so soon is due now, as of the loop's timers
_SELDOM = 64  # so many turns of the loop are made without a look at its own wake-up pipe


class DeadlockError(RuntimeError):
    """Every task waits for something that nothing can bring about."""


class Ticks:
    """A call that comes again and again; see :meth:`VirtualTimeLoop.call_repeatedly`."""

    __slots__ = ("_ticking", "context", "due", "step")

    def __init__(
        self, ticking: list["Ticks"], due: float, step: Callable[[], float | None], context: Context
    ) -> None:
        self._ticking, self.due, self.step, self.context = ticking, due, step, context
        ticking.append(self)

    def cancel(self) -> None:
        """No more calls; harmless when there are none."""
        if self in self._ticking:
            self._ticking.remove(self)


class _JumpingSelector(selectors.BaseSelector):
    """A real selector whose idle waits move a virtual clock instead of taking time."""

    def __init__(self, failed: Callable[[BaseException], None]) -> None:
        self._real = selectors.DefaultSelector()
        self.now = 0.0
        self.outside = 0
        self.own_fds = self.fds = 0  # the loop's own wake-up pipe is no source of events
        self.ticking: list[Ticks] = []
        self.woken = False  # the loop was given something to do since this was False
        self._failed = failed
        self._unlooked = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        events = self._look(timeout)
        if self.ticking and not self.outside:
            idle = not events and (timeout is None or timeout > 0)
            until = self.now + _RESOLUTION_S if not idle else inf if timeout is None else self.now + timeout
            if self._tick(until):
                return events  # what is to come next may have changed
        if events or (timeout is not None and timeout <= 0):
            return events
        if self.outside:
            return self._real.select(None)
        if timeout is not None:
            self.now += timeout
            return []
        if self.fds <= self.own_fds:
            raise DeadlockError("nothing is scheduled, and no file or executor job can wake the loop")
        return self._real.select(None)

    def _tick(self, until: float) -> bool:
        """Make the calls that are due by ``until``, each at its time, as long as none of them gives the loop
        something to do; whether there were any."""
        ticked = self.woken = False
        while self.ticking and not self.woken:
            ticks = min(self.ticking, key=_due)
            if ticks.due > until:
                break
            self.now += max(ticks.due - self.now, 0.0)
            ticked, due = True, None
            try:
                due = ticks.context.run(ticks.step)
            except Exception as exc:  # as of any other callback: the loop tells it and goes on
                self._failed(exc)
            if due is None:
                ticks.cancel()
            else:
                ticks.due = due
        return ticked

    def _look(self, timeout: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        """What is ready now. Where only the loop's own pipe could be, the question is seldom put to the
        system: what a thread hands over is seen at the next turn without it, and signals can wait so long."""
        alone = timeout is not None and not self.outside and self.fds <= self.own_fds
        if alone and self._unlooked < _SELDOM:
            self._unlooked += 1
            return []
        self._unlooked = 0
        return self._real.select(0)

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        key = self._real.register(fileobj, events, data)
        self.fds = len(self._real.get_map())
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        key = self._real.unregister(fileobj)
        self.fds = len(self._real.get_map())
        return key

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.modify(fileobj, events, data)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._real.get_map()

    def close(self) -> None:
        self._real.close()


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """``time()`` starts at 0 and moves only when nothing else is left to do."""

    def __init__(self) -> None:
        self._jumping = _JumpingSelector(self._tick_failed)
        super().__init__(self._jumping)
        self._jumping.own_fds = self._jumping.fds

    def time(self) -> float:
        return self._jumping.now

    def call_repeatedly(self, when: float, step: Callable[[], float | None]) -> Ticks:
        """Call ``step`` at the loop's time ``when``, and again whenever it says, until it says None.

        For what comes by the thousand and seldom gives anybody something to do: unlike a timer that is set
        anew each time it costs the loop no turn.
        """
        self._jumping.woken = True
        return Ticks(self._jumping.ticking, when, step, copy_context())

    def call_soon(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.Handle:
        self._jumping.woken = True
        return super().call_soon(callback, *args, context=context)

    def call_soon_threadsafe(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.Handle:
        self._jumping.woken = True
        return super().call_soon_threadsafe(callback, *args, context=context)

    def call_at(
        self, when: float, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        self._jumping.woken = True
        return super().call_at(when, callback, *args, context=context)

    def _tick_failed(self, exc: BaseException) -> None:
        self.call_exception_handler({"message": "a repeated call failed", "exception": exc})

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


def _due(ticks: Ticks) -> float:
    return ticks.due


def run_virtual(main: Coroutine[Any, Any, T], limit_s: float = 24 * 3600.0) -> T:
    """``asyncio.run`` on a fresh virtual loop; ``TimeoutError`` after ``limit_s`` virtual seconds."""

    async def limited() -> T:
        async with asyncio.timeout(limit_s):
            return await main

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(limited())
