"""systemd's watchdog is fed only by a process that is fit, and a lost device never counts against it."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from daemon.health import Beats, LoopLag, watchdog
from fakes.object import VirtualClock, run_virtual
from tests.kit.object_cell import open_cell, write_config

FAIL_S = 0.5


async def fed_while(act: Callable[[Beats, LoopLag], Awaitable[None]]) -> int:
    """How often the watchdog was fed in ten seconds around ``act``."""
    clock = VirtualClock()
    beats, lag, fed = Beats(clock), LoopLag(clock), []
    task = asyncio.create_task(watchdog(beats, lag, FAIL_S, 1.0, lambda: fed.append(clock.now())))
    await act(beats, lag)
    fed.clear()
    await asyncio.sleep(10.0)
    task.cancel()
    await asyncio.wait([task])
    return len(fed)


def test_a_healthy_process_feeds_every_period() -> None:
    async def healthy(beats: Beats, lag: LoopLag) -> None: ...

    assert run_virtual(fed_while(healthy)) == 10


def test_a_late_loop_withholds_and_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    async def late(beats: Beats, lag: LoopLag) -> None:
        lag.last_s = FAIL_S + 0.1

    with caplog.at_level(logging.INFO, "cellward.health"):
        assert run_virtual(fed_while(late)) == 0
    (line,) = caplog.records
    assert "watchdog withheld: lag 0.600 s" in line.getMessage()


def test_a_silent_task_withholds_by_name(caplog: pytest.LogCaptureFixture) -> None:
    async def silent(beats: Beats, lag: LoopLag) -> None:
        beats.beat("device arm")
        await asyncio.sleep(beats.max_silence_s + 1.0)

    assert run_virtual(fed_while(silent)) == 0
    assert "device arm" in caplog.text


def test_a_task_that_ended_on_purpose_is_not_missed() -> None:
    async def retired(beats: Beats, lag: LoopLag) -> None:
        beats.beat("device arm")
        beats.retire("device arm")
        await asyncio.sleep(beats.max_silence_s + 1.0)

    assert run_virtual(fed_while(retired)) == 10


def test_feeding_goes_on_when_the_lag_is_over() -> None:
    async def recovered(beats: Beats, lag: LoopLag) -> None:
        lag.last_s = FAIL_S + 0.1
        await asyncio.sleep(3.0)
        lag.last_s = 0.0

    assert run_virtual(fed_while(recovered)) == 10


def test_a_lost_device_is_a_state_and_no_reason_to_be_restarted(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            fed: list[float] = []
            lag = LoopLag(cell.clock)
            task = asyncio.create_task(
                watchdog(cell.beats, lag, FAIL_S, 1.0, lambda: fed.append(cell.clock.now()))
            )
            cell.plant.controller.inject("refuse")
            cell.plant.camera.inject("silence")
            await cell.clock.sleep(60.5)
            assert not cell.all_ready()
            assert len(fed) == 61
            task.cancel()
            await asyncio.wait([task])

    run_virtual(main())


def test_the_lag_of_the_loop_is_measured_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    class LateClock(VirtualClock):
        """Wakes up late, as on a busy loop."""

        late_s = 0.0

        async def sleep(self, seconds: float) -> None:
            await super().sleep(seconds + self.late_s)

    async def main() -> None:
        clock = LateClock()
        beats, lag = Beats(clock), LoopLag(clock)
        task = asyncio.create_task(lag.watch(beats, warn_s=0.02))
        await asyncio.sleep(1.0)
        assert lag.last_s == pytest.approx(0.0, abs=1e-9)
        clock.late_s = 0.08
        await asyncio.sleep(1.0)
        assert lag.last_s == pytest.approx(0.08)
        clock.late_s = 0.0
        await asyncio.sleep(1.0)
        assert beats.silent() == []
        task.cancel()
        await asyncio.wait([task])

    with caplog.at_level(logging.INFO, "cellward.health"):
        run_virtual(main())
    (late,) = (r.getMessage() for r in caplog.records)
    assert "late: lag 80.0 ms" in late


def test_a_loop_that_is_late_again_and_again_is_one_line_a_minute(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class HiccupClock(VirtualClock):
        turn = 0

        async def sleep(self, seconds: float) -> None:
            self.turn += 1
            await super().sleep(seconds + (0.08 if self.turn % 10 == 0 else 0.0))

    async def main() -> None:
        clock = HiccupClock()
        task = asyncio.create_task(LoopLag(clock).watch(Beats(clock), warn_s=0.02))
        await asyncio.sleep(480.0)
        task.cancel()
        await asyncio.wait([task])

    with caplog.at_level(logging.INFO, "cellward.health"):
        run_virtual(main())
    lines = [r.getMessage() for r in caplog.records]
    assert 7 <= len(lines) <= 9
    assert "the longest of 1" in lines[1]
