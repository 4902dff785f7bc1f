"""Work for the solver's process that has to be done also when that has died."""

import asyncio
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from cell.errors import CellError
from cell.procedure import Worker

P = ParamSpec("P")
R = TypeVar("R")


async def in_worker(worker: Worker, fn: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """``fn(*args)`` in the solver's process, or in a thread when that died: it must not cost what it writes.

    A thread that makes megabytes of text holds the interpreter while other programs have its core, and the
    loop, which watches the arm, waits for both.
    """
    try:
        return await worker.call(fn, *args, **kwargs)
    except CellError as exc:
        if exc.name != "CHILD_DIED":
            raise
    return await asyncio.to_thread(fn, *args, **kwargs)
