"""The robot's own program, loaded and started over a dashboard on the wire."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ur_driver_rig import Rig, until

from cell.errors import CellError, error
from cell.motion import MotionBroker
from cell.store.runs import RunFolder
from daemon.config.program_after import ProgramAfter
from daemon.program_start import ProgramStart
from daemon.start_request import StartRequest
from drivers.ur import UrArm

pytestmark = pytest.mark.wire

ROBOT = "192.168.1.20"
WORK, NEVER = ("work.urp", lambda: None), ("never.urp", lambda: None)


def too_late() -> None:
    raise error("NOT_NOW", "somebody stopped it")


@pytest.fixture(scope="module")
def shared() -> Iterator[Rig]:
    with Rig.running() as rig:
        yield rig


@pytest.fixture
def rig(shared: Rig) -> Iterator[Rig]:
    yield shared
    shared.tidy()


async def refusal(work: Any) -> CellError:
    with pytest.raises(CellError) as caught:
        await work
    return caught.value


def test_a_program_is_loaded_and_started_and_refusals_have_the_controllers_words(rig: Rig) -> None:
    async def nothing_loaded() -> None:
        async with rig.connected() as subject:
            assert "never.urp is not what is loaded" in str(await refusal(subject.play_program(*NEVER)))

    async def scenario() -> None:
        async with rig.connected() as subject:
            missing = await refusal(subject.load_program("work.script"))
            assert (missing.name, "File not found" in str(missing)) == ("ARM_PROGRAM_NOT_STARTED", True)
            await subject.load_program("work.urp")
            assert rig.truth()["program"] is None, "loading starts nothing"
            await subject.load_program("other.urp")
            assert "other.urp" in str(await refusal(subject.play_program(*WORK)))
            assert rig.truth()["program"] is None, "another client loaded another one"
            await subject.load_program("work.urp")
            assert (await refusal(subject.play_program("work.urp", too_late))).name == "NOT_NOW"
            assert rig.truth()["program"] is None
            await subject.play_program(*WORK)
            await until(lambda: subject.state.latest(1.0).value.program_running)
            assert rig.truth()["program"] == "work.urp"
            assert (await refusal(subject.play_program(*WORK))).name == "ARM_PROGRAM_RUNNING"

    asyncio.run(nothing_loaded())
    rig.play(scenario)


@pytest.mark.parametrize(
    ("fault", "code"), [("local-mode", "ARM_LOCAL_MODE"), ("protective-stop", "ARM_PROTECTIVE_STOP")]
)
def test_an_arm_that_may_not_move_is_told_nothing(rig: Rig, fault: str, code: str) -> None:
    async def scenario() -> None:
        async with rig.connected() as subject:
            await subject.load_program("work.urp")
            rig.inject(fault)
            await until(lambda: subject.fault() is not None)
            assert (await refusal(subject.play_program(*WORK))).name == code
            assert rig.truth()["program"] is None

    rig.play(scenario)


@pytest.mark.parametrize("fault", [None, "safeguard-stop"])
def test_the_daemon_starts_it_after_a_pass_and_not_after_a_safety_event(
    rig: Rig, tmp_path: Path, fault: str | None
) -> None:
    async def scenario() -> None:
        async with rig.connected() as arm:
            subject, folder, run = await asyncio.to_thread(start_of, arm, tmp_path)
            rig.inject("foreign-program")
            await until(lambda: arm.state.latest(1.0).value.program_running)
            rig.inject("clear")
            await until(lambda: not arm.state.latest(1.0).value.program_running)
            subject.asked(run, StartRequest("laser-check", {}, "robot", "modbus", client=ROBOT))
            assert subject.told is not None
            assert subject.told["state"] == "asked"
            subject.procedure_over(run)
            subject.ended(run, folder, {"outcome": "complete", "verdict": "pass"}, None)
            if fault is not None:
                rig.inject(fault)
            await until(lambda: subject.told["state"] in ("started", "not started"), 10.0)
            assert subject.told["state"] == ("started" if fault is None else "not started"), subject.told
            assert rig.truth()["program"] == ("work.urp" if fault is None else None)
            await subject.close()

    rig.play(scenario)


def start_of(arm: UrArm, folder: Path) -> tuple[ProgramStart, RunFolder, Any]:
    """What the daemon has in a cell with this arm, and a run that nothing speaks against."""
    clock = arm.state.clock
    context: Any = SimpleNamespace(
        config=SimpleNamespace(
            robot=SimpleNamespace(
                program_after=ProgramAfter(program="work.urp", asked_from=ROBOT), roles=lambda: {"arm": "arm"}
            )
        ),
        clock=clock,
        broker=MotionBroker(clock),
        device=lambda role: arm,
        supervisor=SimpleNamespace(devices={"arm": SimpleNamespace(device=arm)}),
    )
    run = SimpleNamespace(id=1, steered=False, steps_taken=SimpleNamespace(taken_again=[]))
    number = len(list(folder.iterdir())) + 1  # a scene may be played again
    return (
        ProgramStart(context, lambda: None),
        RunFolder.create(folder, "laser-check", number, {}, clock),
        run,
    )
