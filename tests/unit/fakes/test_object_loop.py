"""The virtual loop: hours in milliseconds, real waits only for real work."""

import asyncio
import gc
import socket
import threading
import time
import weakref

import pytest

from fakes.object import DeadlockError, VirtualClock, VirtualTimeLoop, run_virtual
from fakes.object.registry import world_of


def test_sleeping_takes_no_real_time() -> None:
    async def scene() -> float:
        clock = VirtualClock()
        begin = clock.now()
        await clock.sleep(3600.0)
        return clock.now() - begin

    begin = time.monotonic()
    assert run_virtual(scene()) == pytest.approx(3600.0)
    assert time.monotonic() - begin < 5.0


def test_timers_fire_in_order_at_their_own_time() -> None:
    async def scene() -> list[tuple[str, float]]:
        loop = asyncio.get_running_loop()
        seen: list[tuple[str, float]] = []

        async def at(name: str, seconds: float) -> None:
            await asyncio.sleep(seconds)
            seen.append((name, round(loop.time(), 9)))

        await asyncio.gather(at("late", 2.0), at("early", 0.5), at("middle", 1.25))
        return seen

    assert run_virtual(scene()) == [("early", 0.5), ("middle", 1.25), ("late", 2.0)]


def test_time_stands_still_while_a_thread_works() -> None:
    async def scene() -> tuple[float, float, int]:
        loop = asyncio.get_running_loop()
        begin, real = loop.time(), time.monotonic()
        async with asyncio.timeout(0.01):
            # Far longer than the time-out, which is virtual and so must not strike.
            answer = await asyncio.to_thread(lambda: threading.Event().wait(0.1) or 42)
        return loop.time() - begin, time.monotonic() - real, answer

    virtual, real, answer = run_virtual(scene())
    assert (virtual, answer) == (0.0, 42)
    assert real >= 0.1


def test_timeouts_are_virtual() -> None:
    async def scene() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(7.0):
                await asyncio.Event().wait()
        return asyncio.get_running_loop().time()

    assert run_virtual(scene()) == pytest.approx(7.0)


def test_a_run_that_goes_on_too_long_ends() -> None:
    async def scene() -> None:
        for _ in range(10_000):
            await asyncio.sleep(1.0)

    with pytest.raises(TimeoutError):
        run_virtual(scene(), limit_s=60.0)


def test_waiting_for_what_can_never_come_is_a_deadlock() -> None:
    async def scene() -> None:
        await asyncio.Event().wait()

    loop = VirtualTimeLoop()
    work = loop.create_task(scene())
    try:
        with pytest.raises(DeadlockError, match="nothing is scheduled"):
            loop.run_until_complete(work)
        work.cancel()
        with pytest.raises(asyncio.CancelledError):
            loop.run_until_complete(work)
    finally:
        loop.close()


def test_somebody_outside_may_wake_the_loop_while_time_is_held() -> None:
    async def scene() -> float:
        loop = asyncio.get_running_loop()
        woken = asyncio.Event()
        assert isinstance(loop, VirtualTimeLoop)
        timer = threading.Timer(0.05, lambda: loop.call_soon_threadsafe(woken.set))
        with loop.outside():
            timer.start()
            async with asyncio.timeout(1.0):
                await woken.wait()
        timer.join()
        return loop.time()

    assert run_virtual(scene()) == 0.0


def test_real_sockets_work_when_nothing_is_scheduled() -> None:
    async def scene() -> bytes:
        loop = asyncio.get_running_loop()
        ours, theirs = socket.socketpair()
        with ours, theirs:
            ours.setblocking(False)
            timer = threading.Timer(0.05, lambda: theirs.send(b"hello"))
            timer.start()
            data = await loop.sock_recv(ours, 16)
            timer.join()
            return data

    loop = VirtualTimeLoop()
    try:
        assert loop.run_until_complete(scene()) == b"hello"
    finally:
        loop.close()


def test_the_clock_can_be_made_before_the_loop_and_read_after_it() -> None:
    clock = VirtualClock()
    begin = clock.now()

    async def scene() -> None:
        assert clock.now() == begin
        await clock.sleep(2.5)

    run_virtual(scene())
    assert clock.now() == begin + 2.5


def test_a_world_goes_with_the_clock_of_its_run() -> None:
    clock = VirtualClock()
    world = weakref.ref(world_of("hand_eye", clock))
    assert world_of("hand_eye", clock) is world()
    del clock
    gc.collect()
    assert world() is None


def test_repeated_calls_come_at_their_own_times_between_timers() -> None:
    async def scene() -> list[float]:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualTimeLoop)
        seen: list[float] = []

        def step() -> float | None:
            seen.append(round(loop.time(), 9))
            return None if len(seen) == 4 else loop.time() + 0.1

        loop.call_repeatedly(0.1, step)
        await asyncio.sleep(0.25)
        seen.append(round(loop.time(), 9))
        await asyncio.sleep(10.0)
        return seen

    assert run_virtual(scene()) == [0.1, 0.2, 0.25, 0.3]


def test_time_stands_where_a_repeated_call_wakes_somebody() -> None:
    async def scene() -> float:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualTimeLoop)
        third, count = asyncio.Event(), 0

        def step() -> float:
            nonlocal count
            count += 1
            if count == 3:
                third.set()
            return loop.time() + 0.1

        ticks = loop.call_repeatedly(0.1, step)
        async with asyncio.timeout(5.0):
            await third.wait()
        woken = loop.time()
        ticks.cancel()
        await asyncio.sleep(1.0)
        assert count == 3
        return woken

    assert run_virtual(scene()) == pytest.approx(0.3)


def test_a_repeated_call_that_fails_is_told_and_comes_no_more() -> None:
    async def scene() -> list[str]:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualTimeLoop)
        told: list[str] = []
        loop.set_exception_handler(lambda _, about: told.append(str(about["exception"])))

        def step() -> float:
            raise ValueError("no sample")

        loop.call_repeatedly(0.1, step)
        await asyncio.sleep(1.0)
        return told

    assert run_virtual(scene()) == ["no sample"]
