"""The timer behind polling: exact ticks, numbered, and none made up for."""

import asyncio
import os
import time
from itertools import pairwise

import pytest

from drivers.modbus.ticker import Ticker

pytestmark = pytest.mark.wire
PERIOD = 0.002


async def ticks(subject: Ticker, count: int) -> list[tuple[int, float]]:
    return [(await subject.wait(), time.monotonic()) for _ in range(count)]


def test_ticks_are_numbered_by_the_time_since_the_start_and_do_not_drift() -> None:
    async def scene() -> None:
        subject = Ticker(PERIOD)
        begun = time.monotonic()
        subject.start()
        seen = await ticks(subject, 100)
        subject.stop()
        assert all(b > a for (a, _), (b, _) in pairwise(seen))
        late = sorted(t - begun - number * PERIOD for number, t in seen)
        assert late[0] > -1e-3
        assert late[len(late) // 2] < 0.5 * PERIOD, "asyncio.sleep would be a millisecond late each time"

    asyncio.run(scene())


def test_ticks_of_a_busy_loop_are_gone_and_the_numbers_say_so() -> None:
    async def scene() -> None:
        subject = Ticker(PERIOD)
        subject.start()
        before = await subject.wait()
        end = time.monotonic() + 10.5 * PERIOD
        while time.monotonic() < end:
            pass
        after = [number for number, _ in await ticks(subject, 3)]
        subject.stop()
        assert after[0] >= before + 10
        assert after[1] > after[0]

    asyncio.run(scene())


def test_a_tick_that_nobody_waited_for_is_not_given_later() -> None:
    async def scene() -> None:
        subject = Ticker(PERIOD)
        subject.start()
        await subject.wait()
        await asyncio.sleep(3.4 * PERIOD)
        asked = time.monotonic()
        number = await subject.wait()
        assert number >= 4
        assert time.monotonic() - asked > 1e-5
        subject.stop()

    asyncio.run(scene())


def test_a_stopped_timer_leaves_no_file_open() -> None:
    async def scene() -> int:
        subject = Ticker(PERIOD)
        subject.start()
        await subject.wait()
        subject.stop()
        subject.stop()
        return len(os.listdir("/proc/self/fd"))

    first = asyncio.run(scene())
    assert [asyncio.run(scene()) for _ in range(3)] == [first] * 3
