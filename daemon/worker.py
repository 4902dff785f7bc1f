"""One pre-warmed process for solving and planning, so that the loop never computes."""

import asyncio
import ctypes
import gc
import os
import signal
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context, resource_tracker
from typing import Any, TypeVar

from cell.errors import error
from cell.forking import may_fork
from cell.priority import COMPUTING, yield_to_others

R = TypeVar("R")
_PR_SET_PDEATHSIG = 1
# What outlives a killed daemon to remove its semaphores; that it has to is nothing that anybody can act on.
_QUIET_TRACKER = "ignore:resource_tracker:UserWarning"


def _keep_to_ourselves(niceness: int) -> None:
    """Die with the parent, leave signals to it, and let its loop, which watches the arm, come first."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield_to_others(niceness)


def _warm_up(configured: Mapping[str, str], niceness: int) -> None:
    """Import what jobs compute with before it is needed.

    ``configured`` are the jobs that only a configuration names: their results are of kinds of their own.
    """
    _keep_to_ourselves(niceness)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # one BLAS thread: the same data give the same bits
    from procedures.registry import add_configured  # after the lines above, which numpy reads once

    for name, reference in configured.items():
        with suppress(LookupError):  # a result of its kind then says what is missing
            add_configured(name, reference)


def _warm_up_forked(niceness: int) -> None:
    """As :func:`_warm_up` for a copy of the daemon, which has imported everything before."""
    gc.freeze()  # a collection would write on pages that are shared as long as nobody does
    _keep_to_ourselves(niceness)


def _start_tracker() -> None:
    """Start the process that cleans up after us without its warning; it takes over our warning options."""
    sys.warnoptions.append(_QUIET_TRACKER)
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.remove(_QUIET_TRACKER)


def _new_pool(niceness: int = COMPUTING) -> ProcessPoolExecutor:
    from procedures.registry import CONFIGURED

    _start_tracker()
    return ProcessPoolExecutor(
        1, mp_context=get_context("spawn"), initializer=_warm_up, initargs=(dict(CONFIGURED), niceness)
    )


def _ready() -> int:
    return os.getpid()


class ProcessWorker:
    """Runs module-level functions in its process; a worker that ended is replaced at the next call."""

    def __init__(self, niceness: int = COMPUTING) -> None:
        self._niceness = niceness
        self._pool: ProcessPoolExecutor | None = None

    def fork(self) -> None:
        """Make the first process a copy of this one, which is warm at once; for a program that begins.

        Where that must not be, as an imported package has started threads, nothing is done: the process
        starts as those that replace it do.
        """
        if may_fork():
            self._pool = ProcessPoolExecutor(
                1,
                mp_context=get_context("fork"),
                initializer=_warm_up_forked,
                initargs=(self._niceness,),
            )
            self._pool.submit(_ready)  # processes are started when there is work

    async def start(self) -> int:
        """Start the process and wait until it is warm; returns its pid."""
        return await self.call(_ready)

    async def call(self, fn: Callable[..., R], *args: Any, **kwargs: Any) -> R:
        """``fn(*args, **kwargs)`` in the worker; its exceptions come back as they are.

        A call that is cancelled ends the process: nobody wants its answer, and the next call must not wait
        for it.
        """
        pool = self._pool = self._pool or _new_pool(self._niceness)
        work: Future[R] | None = None
        try:
            work = pool.submit(fn, *args, **kwargs)
            return await asyncio.wrap_future(work)
        except asyncio.CancelledError:
            if work is not None and not work.cancel() and not work.done():
                self._drop(pool)
            raise
        except BrokenProcessPool as exc:
            self._drop(pool)
            raise error("CHILD_DIED", f"the solver process ended while computing {fn.__name__}") from exc

    def _drop(self, pool: ProcessPoolExecutor) -> None:
        """End the pool's process at once; what else it had to do fails with ``CHILD_DIED``."""
        if self._pool is pool:
            self._pool = None
        # Python 3.11 has no public way to end a pool's process; shutdown forgets which it was.
        for process in tuple((pool._processes or {}).values()):  # noqa: SLF001
            process.kill()
        pool.shutdown(wait=False, cancel_futures=True)

    async def stop(self) -> None:
        pool, self._pool = self._pool, None
        if pool is not None:
            await asyncio.to_thread(pool.shutdown, wait=True, cancel_futures=True)


class InlineWorker:
    """Computes on the loop; only for the object twin, where time stands still meanwhile."""

    async def call(self, fn: Callable[..., R], *args: Any, **kwargs: Any) -> R:
        return fn(*args, **kwargs)

    async def start(self) -> int:
        return os.getpid()

    async def stop(self) -> None:
        return None
