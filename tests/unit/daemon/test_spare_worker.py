"""The process that computes what the page's visitors ask: bounded in time, and gone when nobody asks."""

import asyncio
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from daemon.spare_worker import NICENESS, SpareWorker
from daemon.worker import ProcessWorker


class Played(ProcessWorker):
    """Answers at once on the loop, or never where it is asked to be silent."""

    def __init__(self) -> None:
        super().__init__()
        self.stopped, self.ended = 0, asyncio.Event()

    async def call(self, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        if fn is silence:
            await asyncio.Event().wait()
        return fn(*args, **kwargs)

    async def stop(self) -> None:
        self.stopped += 1
        self.ended.set()


def silence() -> None: ...


def await_end(pid: int) -> None:
    while Path(f"/proc/{pid}").exists():
        time.sleep(0.01)


@pytest.mark.wire
def test_its_process_comes_behind_all_others_and_ends_when_nobody_asks() -> None:
    async def main() -> None:
        subject = SpareWorker(idle_s=0.2)
        async with asyncio.timeout(60.0):
            niceness, pid, policy = await subject.call(eval, PRIORITY)
            assert (niceness, policy) == (NICENESS, os.SCHED_BATCH)
            assert pid != os.getpid()
            await asyncio.to_thread(await_end, pid)
        await subject.stop()

    asyncio.run(main())


PRIORITY = "[(os.getpriority(0, 0), os.getpid(), os.sched_getscheduler(0)) for os in [__import__('os')]][0]"


def test_who_asks_again_soon_meets_the_same_process_and_later_a_new_one() -> None:
    made: list[Played] = []

    def make() -> Played:
        made.append(Played())
        return made[-1]

    async def main() -> None:
        subject = SpareWorker(make, idle_s=0.05)
        assert [await subject.call(str.upper, letter) for letter in "ab"] == ["A", "B"]
        assert (len(made), made[0].stopped) == (1, 0)
        async with asyncio.timeout(10.0):
            await made[0].ended.wait()
        assert await subject.call(str.upper, "c") == "C"
        await subject.stop()
        assert [one.stopped for one in made] == [1, 1]

    asyncio.run(main())


def test_what_takes_too_long_is_given_up_and_the_next_question_is_answered() -> None:
    async def main() -> None:
        subject = SpareWorker(Played, longest_s=0.05)
        with pytest.raises(TimeoutError):
            await subject.call(silence)
        assert await subject.call(str.upper, "a") == "A"
        await subject.stop()

    asyncio.run(main())
