"""What is looked at before an arm moves again after a silence: its programs, and who ended ours."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from cell.devices import ToolSettings
from cell.errors import CellError, error
from cell.interruptions import Interruptions
from cell.procedure import Run
from fakes.object import run_virtual
from tests.kit.motion_bench import Bench, ScriptedArm, bench_with, no_wait


async def interrupted(bench: Bench, steps: Interruptions) -> None:
    """A step that a silence of another device interrupts once, with a lease on the arm."""

    async def work() -> None:
        if not steps.taken_again:
            raise error("STALE_DATA", "beams")

    async with bench.lease(steps):
        await steps.step("reading", work)


@pytest.mark.parametrize("its_own", [True, False])
def test_a_program_that_came_and_went_in_the_silence_ends_the_run(its_own: bool) -> None:
    async def main() -> None:
        arm = ScriptedArm(usable=False)

        async def devices() -> None:
            arm.program_running = False  # our watchdog ended our script
            await asyncio.sleep(0.3)
            arm.program_running = not its_own
            await asyncio.sleep(0.8)
            arm.program_running = False
            await asyncio.sleep(0.2)

        async with bench_with(arm) as bench:
            steps = Interruptions(arm.clock, devices, bench.notes.note)
            if its_own:
                await interrupted(bench, steps)
                return
            with pytest.raises(CellError) as ended:
                await interrupted(bench, steps)
            assert ended.value.name == "ARM_PROGRAM_RUNNING"

    run_virtual(main())


def test_who_ended_our_script_is_asked_though_opening_it_again_was_interrupted() -> None:
    async def main() -> list[str]:
        arm, asked, failed = ScriptedArm(usable=False, ended_unseen=True), list[str](), False
        opened = arm.open_motion

        async def open_motion(tool: ToolSettings) -> ScriptedArm:
            nonlocal failed
            if "close" in arm.asked and not failed:
                failed = True
                raise error("STALE_DATA", "arm")
            return await opened(tool)

        arm.open_motion = open_motion  # type: ignore[method-assign]
        async with bench_with(arm) as bench:
            await interrupted(bench, Interruptions(arm.clock, no_wait, bench.notes.note, ask=asked.append))
        assert failed
        return asked

    assert len(run_virtual(main())) == 1


def test_a_silence_that_lasts_at_the_end_of_a_step_interrupts_it() -> None:
    async def main() -> None:
        arm = ScriptedArm()

        async def wait_fresh(timeout: float) -> None:
            await asyncio.sleep(timeout)
            raise error("DEVICE_LOST", "arm")

        arm.wait_fresh = wait_fresh  # type: ignore[attr-defined]
        async with bench_with(arm):
            await asyncio.sleep(0.5)
            began = arm.clock.now()
            run: Any = SimpleNamespace(
                procedure=SimpleNamespace(uses=lambda: ("arm",)), arm=lambda: arm, clock=arm.clock
            )
            await Run._require_unbroken(run, began)
            arm.silent = True
            await asyncio.sleep(0.9)
            with pytest.raises(CellError) as ended:
                await Run._require_unbroken(run, began)
            assert ended.value.name == "STALE_DATA"

    run_virtual(main())
