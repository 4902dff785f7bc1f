"""A stop or a hold, at any time since the check, keeps the arm's own program from starting or stops it."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from cell.errors import error
from cell.procedure import Run
from daemon.plc import PlcFace
from daemon.start_request import StartRequest
from fakes.object.arm import ObjectArm
from fakes.object.controller import Program
from tests.kit.object_cell import WHO, ObjectCell, no_report, refused
from tests.kit.program_after import JOB, Check, ask, before, ends, not_started, over, scene, starting

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


@pytest.mark.parametrize("verb", ["abort", "halt", "pause"])
def test_a_stop_while_it_is_being_loaded_keeps_it_from_starting(tmp_path: Path, verb: str) -> None:
    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await starting(cell)
        await getattr(cell.engine, verb)("the operator")
        await over(cell)
        not_started(cell, run_id, "stopped by the operator")
        assert (await refused(cell.engine.halt(WHO))).name == "NOT_NOW"

    scene(tmp_path, act)


def test_a_stop_right_after_the_controller_was_told_stops_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    play, told = ObjectArm.play_program, asyncio.Event()

    async def slow(self: ObjectArm, program: str, last_look: Callable[[], None]) -> None:
        await play(self, program, last_look)
        told.set()
        await self.clock.sleep(1.0)

    monkeypatch.setattr(ObjectArm, "play_program", slow)

    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await told.wait()
        assert cell.plant.controller.program is Program.FOREIGN
        await cell.engine.halt("the operator")
        await over(cell)
        not_started(cell, run_id, "the arm's program was stopped")

    scene(tmp_path, act)


@pytest.mark.parametrize(
    ("meanwhile", "verb"),
    [
        ("propose_results", "halt"),
        ("propose_results", "abort"),
        ("write_end", "halt"),
        ("write_end", "abort"),
        ("write_end", "finish"),
        ("write_end", "pause"),
        ("write_end", "heartbeat"),
    ],
)
def test_a_stop_while_the_end_is_being_made_is_taken_and_keeps_it_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, meanwhile: str, verb: str
) -> None:
    async def act(cell: ObjectCell) -> None:
        async def stop() -> None:
            if verb == "heartbeat":
                PlcFace(cell.config, cell.engine).heartbeat_changed(False)
            else:
                await getattr(cell.engine, verb)("the operator")

        before(monkeypatch, meanwhile, stop)
        by = "the lost heartbeat of the PLC" if verb == "heartbeat" else "the operator"
        await ends(cell, f"stopped by {by}")
        assert cell.plant.controller.loaded_program == ""

    scene(tmp_path, act)


def test_a_stop_right_after_the_last_act_of_the_job_keeps_it_from_starting(tmp_path: Path) -> None:
    async def act(cell: ObjectCell) -> None:
        stops: list[asyncio.Task[None]] = []

        class Last(Check):
            async def run(self, run: Run) -> None:
                await super().run(run)
                stops.append(asyncio.create_task(cell.engine.halt("the operator")))

        await ends(cell, "stopped by the operator", Last)
        await stops[0]

    scene(tmp_path, act)


def test_a_finish_that_comes_before_the_run_can_be_finished_keeps_it_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def act(cell: ObjectCell) -> None:
        before(monkeypatch, "make_run", lambda: refused(cell.engine.finish("the operator")))
        await ends(cell, "stopped by the operator")

    scene(tmp_path, act)


def test_a_late_start_that_a_stop_overtakes_is_stopped_and_no_job_begins_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def late(self: ObjectArm, program: str, last_look: Callable[[], None]) -> None:
        last_look()
        self.controller.later(3.0, self.controller.start_foreign)
        raise error("CALL_TIMEOUT", "dashboard 'play'")

    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await cell.until(lambda: cell.plant.controller.program is Program.FOREIGN, "the late start")
        assert (await refused(cell.engine.start(StartRequest(JOB, {}, WHO, "control")))).name == "BUSY"
        await over(cell)
        not_started(cell, run_id, "dashboard 'play'; the arm's program was stopped")
        await cell.engine.start(StartRequest(JOB, {}, WHO, "control"))

    monkeypatch.setattr(ObjectArm, "play_program", late)
    scene(tmp_path, act)


def test_a_program_that_goes_on_though_it_was_told_to_stop_is_not_told_as_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def act(cell: ObjectCell) -> None:
        async def deaf(self: ObjectArm) -> None: ...

        await ask(cell)
        monkeypatch.setattr(ObjectArm, "stop_program", deaf)
        await cell.until(lambda: cell.plant.controller.program is Program.FOREIGN, "the start")
        await cell.engine.halt("the operator")
        await over(cell)
        told = cell.engine.status()["program_start"]
        assert (told["state"], "runs though it was told to stop" in told["text"]) == ("not started", True)

    scene(tmp_path, act)


def test_a_second_stop_while_it_is_taken_back_leaves_the_arm_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = asyncio.Event()

    async def clings(self: ObjectArm, program: str, last_look: Callable[[], None]) -> None:
        told.set()
        try:
            await self.clock.sleep(9.0)
        finally:
            await self.clock.sleep(0.5)

    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await told.wait()
        await cell.engine.halt("the operator")
        await cell.clock.sleep(0.1)
        await cell.engine.halt("another")
        await over(cell)
        not_started(cell, run_id, "stopped by the operator")
        cell.context.broker.acquire(cell.supervisor.devices["arm"].device)  # type: ignore[arg-type]

    monkeypatch.setattr(ObjectArm, "play_program", clings)
    scene(tmp_path, act)
