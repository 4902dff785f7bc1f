"""An error about a reading that is too old names this machine's own delay, and only when there was one."""

import asyncio
from collections.abc import Iterator
from contextlib import suppress

import pytest

from cell import own_delay
from cell.errors import CellError
from cell.samples import Sample, Stream
from daemon.health import Beats, LoopLag


class StoppedClock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.t = 100.0

    def now(self) -> float:
        return self.t

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(0)


@pytest.fixture(autouse=True)
def nothing_known() -> Iterator[None]:
    own_delay.forget()
    yield
    own_delay.forget()


def stale(clock: StoppedClock) -> str:
    subject: Stream[float] = Stream("arm", clock)
    subject.push(Sample(1.0, clock.t - 0.136, 0.001, 1))
    with pytest.raises(CellError) as caught:
        subject.latest(0.1)
    return str(caught.value)


def test_a_link_alone_is_blamed_while_the_loop_is_in_time() -> None:
    assert stale(StoppedClock()).endswith("newest sample is 0.136 s old, limit 0.100 s")


def test_a_delay_that_was_noted_is_named_for_two_seconds() -> None:
    clock = StoppedClock()
    own_delay.expect(clock.t)
    clock.t += 0.092
    own_delay.woken(clock.t)
    own_delay.expect(clock.t + 0.05)
    assert stale(clock).endswith("limit 0.100 s; this machine was busy: loop lag 92 ms")
    clock.t += 2.5
    own_delay.expect(clock.t + 0.05)
    assert "busy" not in stale(clock)


def test_a_delay_that_still_goes_on_is_named_before_the_monitor_is_woken() -> None:
    clock = StoppedClock()
    own_delay.expect(clock.t)
    clock.t += 0.15
    assert stale(clock).endswith("loop lag 150 ms")


def test_the_health_monitor_notes_what_it_measures_and_forgets_at_its_end() -> None:
    clock = StoppedClock()

    async def main() -> None:
        task = asyncio.create_task(LoopLag(clock).watch(Beats(clock), 0.02))
        await asyncio.sleep(0)
        clock.t += 0.3
        for _ in range(3):
            await asyncio.sleep(0)
        assert own_delay.longest(clock.t) == pytest.approx(0.25)
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        assert own_delay.longest(clock.t) == 0.0

    asyncio.run(main())
