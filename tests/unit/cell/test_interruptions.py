"""How often a step is taken again, and what ends a run, without a cell around it."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError, error
from cell.interruptions import Interruptions


class HeldArm:
    """Notes what is asked of it; ``trouble`` comes out of the next takings up."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.trouble: list[CellError] = []
        self.lost = False

    def leave(self) -> bool:
        return self.lost

    async def rest(self) -> None:
        self.asked.append("rest")

    async def take_up(self) -> None:
        self.asked.append("take up")
        if self.trouble:
            raise self.trouble.pop()


async def at_once() -> None: ...


def taking(**keys: Any) -> Interruptions:
    subject = Interruptions(MonotonicClock(), at_once, lambda kind, **fields: None, **keys)
    subject.arm = HeldArm()
    return subject


def failing(times: int, name: str = "STALE_DATA") -> Callable[[], Awaitable[str]]:
    """Work that fails so often before it is done."""
    left = times

    async def work() -> str:
        nonlocal left
        if left:
            left -= 1
            raise error(name, "silent")
        return "done"

    return work


def test_a_step_that_a_silence_interrupted_is_taken_again_with_the_arm_at_rest_between() -> None:
    subject = taking()
    assert asyncio.run(subject.step("move", failing(2))) == "done"
    assert isinstance(subject.arm, HeldArm)
    assert subject.arm.asked == ["rest", "take up"] * 2
    assert [entry["step"] for entry in subject.taken_again] == ["move", "move"]


def test_the_third_in_a_row_ends_the_run_and_a_finished_step_begins_a_new_row() -> None:
    subject = taking()

    async def main() -> None:
        for _ in range(3):
            await subject.step("move", failing(2))
        await subject.step("move", failing(3))

    with pytest.raises(CellError, match="silent"):
        asyncio.run(main())
    assert len(subject.taken_again) == 8


def test_the_tenth_in_all_ends_the_run() -> None:
    subject = taking()

    async def main() -> None:
        for _ in range(10):
            await subject.step("move", failing(1))

    with pytest.raises(CellError, match="silent"):
        asyncio.run(main())
    assert len(subject.taken_again) == 9


def test_losses_beside_the_steps_count_among_all() -> None:
    subject = taking()
    for _ in range(9):
        assert subject.bridges(error("DEVICE_LOST", "camera"))
        subject.interrupt(error("DEVICE_LOST", "camera"))
    assert not subject.bridges(error("DEVICE_LOST", "camera"))


def test_an_arm_that_was_lost_between_two_steps_is_taken_up_before_the_next_one() -> None:
    subject = taking()
    assert isinstance(subject.arm, HeldArm)
    asked = subject.arm.asked

    async def main() -> None:
        await subject.step("first", failing(0))
        subject.arm.lost = True  # type: ignore[union-attr]
        subject.interrupt(error("DEVICE_LOST", "arm"))
        subject.arm.lost = False  # type: ignore[union-attr]
        assert asked == []

        async def work() -> None:
            asked.append("work")

        await subject.step("second", work)
        await subject.step("third", work)

    asyncio.run(main())
    assert asked == ["rest", "take up", "work", "work"]
    assert [entry["step"] for entry in subject.taken_again] == ["second"]


def test_another_silence_while_the_arm_is_taken_up_is_the_next_in_the_row() -> None:
    subject = taking()
    assert isinstance(subject.arm, HeldArm)
    subject.arm.trouble = [error("STALE_DATA", "again")]
    assert asyncio.run(subject.step("move", failing(1))) == "done"
    assert subject.arm.asked == ["rest", "take up"] * 2


@pytest.mark.parametrize(
    "name",
    [
        "ARM_PROTECTIVE_STOP",
        "ARM_SCRIPT_DIED",
        "ARM_PROGRAM_RUNNING",
        "ARM_REBOOTED",
        "ARM_MOVED",
        "CHILD_DIED",
    ],
)
def test_what_is_no_silence_ends_the_run_at_once(name: str) -> None:
    subject = taking()
    with pytest.raises(CellError) as failure:
        asyncio.run(subject.step("move", failing(1, name)))
    assert failure.value.name == name
    assert subject.taken_again == []


def test_a_trouble_of_the_arm_that_shows_when_it_is_taken_up_ends_the_run() -> None:
    subject = taking()
    assert isinstance(subject.arm, HeldArm)
    subject.arm.trouble = [error("ARM_MOVED", "jogged")]
    with pytest.raises(CellError, match="jogged"):
        asyncio.run(subject.step("move", failing(1)))


def test_a_pause_of_this_process_that_is_too_long_ends_the_run() -> None:
    subject = taking(paused=lambda since: 5.0)
    with pytest.raises(CellError, match="silent"):
        asyncio.run(subject.step("move", failing(1)))


def test_a_step_within_a_step_is_taken_again_as_part_of_it() -> None:
    subject, begun = taking(), []
    inner = failing(1)

    async def outer() -> str:
        begun.append("outer")
        return await subject.step("inner", inner)

    assert asyncio.run(subject.step("outer", outer)) == "done"
    assert begun == ["outer", "outer"]
    assert [entry["step"] for entry in subject.taken_again] == ["outer"]


def test_a_cancel_ends_the_step_before_it_is_raised() -> None:
    subject, ended = taking(), []

    async def slow() -> None:
        try:
            await asyncio.sleep(10.0)
        finally:
            await asyncio.sleep(0.01)
            ended.append(True)

    async def main() -> None:
        task = asyncio.create_task(subject.step("move", slow))
        await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert ended == [True]

    asyncio.run(main())


def test_an_arm_that_is_lost_while_the_run_is_held_is_taken_up_before_the_step_is_taken_again() -> None:
    async def main() -> list[str]:
        held, go_on = asyncio.Event(), asyncio.Event()

        async def released() -> None:
            held.set()
            await go_on.wait()

        subject = taking(released=released)
        arm = subject.arm
        assert isinstance(arm, HeldArm)
        failed = False

        async def work() -> None:
            nonlocal failed
            if not failed:
                failed = True
                raise error("STALE_DATA", "silent")
            arm.asked.append("work")

        step = asyncio.create_task(subject.step("move", work))
        await held.wait()
        arm.lost = True
        subject.interrupt(error("DEVICE_LOST", "arm"))
        arm.lost = False
        go_on.set()
        await step
        return arm.asked

    assert asyncio.run(main()) == ["rest", "take up", "rest", "take up", "work"]


def test_every_loss_between_two_steps_counts() -> None:
    subject = taking()
    assert isinstance(subject.arm, HeldArm)
    subject.arm.lost = True
    for _ in range(10):
        subject.interrupt(error("DEVICE_LOST", "arm"))
    with pytest.raises(CellError) as ended:
        asyncio.run(subject.step("move", failing(0)))
    assert ended.value.name == "DEVICE_LOST"
