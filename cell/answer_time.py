"""Waiting for an answer, without blaming who answers for a pause of this process."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

TICK_S = 0.1


@asynccontextmanager
async def answer_within(seconds: float) -> AsyncIterator[None]:
    """``TimeoutError`` when the body takes longer than ``seconds``.

    A process that stood still finds timers run out and answers arrived at once, and its loop serves the
    timers first. Time that the loop itself lost is therefore not counted, and the body gets one more look.
    """
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(None) as limit:
        left, spared, due = max(seconds, 0.0), False, loop.time()
        timer: asyncio.TimerHandle | None = None

        def look() -> None:
            nonlocal left, spared
            stood_still = loop.time() - due > TICK_S
            if left <= 0.0 and stood_still and not spared:
                left, spared = TICK_S, True
            if left <= 0.0:
                limit.reschedule(loop.time())
            else:
                wait()

        def wait() -> None:
            nonlocal left, due, timer
            planned = min(left, TICK_S)
            left, due = left - planned, loop.time() + planned
            timer = loop.call_at(due, look)

        wait()
        try:
            yield
        finally:
            if timer is not None:
                timer.cancel()
