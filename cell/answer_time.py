"""Waiting for an answer, without blaming who answers for a pause of this process."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

TICK_S = 0.1
MOST_LOST_S = 5.0


@asynccontextmanager
async def answer_within(seconds: float) -> AsyncIterator[None]:
    """``TimeoutError`` when the body takes longer than ``seconds``.

    A process that stood still finds timers run out and answers arrived at once, and its loop serves the
    timers first. Where the loop lost more than ``TICK_S`` at once, that time is not counted, up to
    ``MOST_LOST_S`` in all, and the body gets another look at what has arrived.
    """
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(None) as limit:
        end, forgivable, due = loop.time() + seconds, MOST_LOST_S, loop.time()
        timer: asyncio.TimerHandle | None = None

        def look() -> None:
            nonlocal end, forgivable
            now = loop.time()
            if now - due > TICK_S and forgivable > 0.0:
                forgiven = min(now - due, forgivable)
                forgivable -= forgiven
                end = max(end + forgiven, now + TICK_S)
            if now >= end:
                limit.reschedule(now)
            else:
                wait()

        def wait() -> None:
            nonlocal due, timer
            due = min(loop.time() + TICK_S, end)
            timer = loop.call_at(due, look)

        wait()
        try:
            yield
        finally:
            if timer is not None:
                timer.cancel()
