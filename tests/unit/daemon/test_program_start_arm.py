"""What the arm shows between the end of the check and the start of its own program keeps it from starting."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.errors import error
from cell.procedure import Run
from fakes.object.arm import ObjectArm
from fakes.object.controller import Controller, Program
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.program_after import Act, ask, before, ends, not_started, over, scene, starting, with_check

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


async def _local(cell: ObjectCell) -> None:
    cell.plant.controller.inject("local-mode")


async def _foreign(cell: ObjectCell) -> None:
    cell.plant.controller.start_foreign()
    cell.plant.controller.later(1.0, cell.plant.controller.stop_program)


async def _latched(cell: ObjectCell) -> None:
    cell.context.broker.latch(error("ARM_PROTECTIVE_STOP", "of an earlier run"))


@pytest.mark.parametrize(
    ("last_act", "why"),
    [(_local, "local mode"), (_foreign, "not ours"), (_latched, "of an earlier run")],
)
def test_an_arm_that_may_not_move_then_starts_nothing(tmp_path: Path, last_act: Act, why: str) -> None:
    async def act(cell: ObjectCell) -> None:
        async def during(run: Run) -> None:
            await last_act(cell)

        run_id = await ask(cell, with_check(during=staticmethod(during)))
        await over(cell)
        await cell.clock.sleep(1.5)
        not_started(cell, run_id, why)
        assert cell.plant.controller.loaded_program == ""

    scene(tmp_path, act)


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("protective-stop", "protective stop"),
        ("safeguard-stop", "Safeguard"),
        ("local-mode", "local mode"),
        ("drop", "arm"),
        ("silence", "gave no state for 0.1"),
    ],
)
def test_a_fault_while_it_is_being_loaded_keeps_it_from_starting(
    tmp_path: Path, fault: str, why: str
) -> None:
    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await starting(cell)
        cell.plant.controller.inject(fault)
        await cell.clock.sleep(0.15)
        cell.plant.controller.clear()  # what was there for a moment counts, too
        await over(cell)
        not_started(cell, run_id, why)

    scene(tmp_path, act)


def test_an_arm_that_is_not_seen_at_rest_starts_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def moving(*_: Any) -> bool:
        return False

    monkeypatch.setattr("daemon.program_start.measured_standstill", moving)
    scene(tmp_path, lambda cell: ends(cell, "was not seen at rest"))


def test_an_arm_that_was_pushed_since_the_run_starts_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = ObjectArm.load_program

    async def pushed(self: ObjectArm, program: str) -> None:
        await load(self, program)
        reported = self.world.reported.joints_at
        monkeypatch.setattr(
            self.world.reported, "joints_at", lambda times, q, qd: (reported(times, q, qd)[0] + 0.01, qd)
        )
        self._resting = self._ahead = None

    monkeypatch.setattr(ObjectArm, "load_program", pushed)
    scene(tmp_path, lambda cell: ends(cell, "a joint turned by 0.0100 rad"))


def test_a_program_that_the_controller_does_not_have_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def missing(self: ObjectArm, program: str) -> None:
        raise error("ARM_PROGRAM_NOT_STARTED", "File not found")

    monkeypatch.setattr(ObjectArm, "load_program", missing)
    scene(tmp_path, lambda cell: ends(cell, "File not found"))


def test_a_program_that_is_not_seen_to_run_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[float] = []

    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        monkeypatch.setattr(Controller, "start_foreign", lambda self: None)
        monkeypatch.setattr(Controller, "stop_program", lambda self: stops.append(self.clock.now()))
        await over(cell)
        not_started(cell, run_id, "shows no program that runs 5 s after it was told to")
        assert len(stops) == 1

    scene(tmp_path, act)


def test_nothing_is_started_that_the_journal_does_not_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise error("DISK_FULL", "journal.jsonl")

    async def act(cell: ObjectCell) -> None:
        monkeypatch.setattr("daemon.program_start._note", full)
        await ask(cell)
        await over(cell)
        told = cell.engine.status()["program_start"]
        assert (told["state"], "journal.jsonl" in told["text"]) == ("not started", True)
        assert cell.plant.controller.program is Program.NONE

    scene(tmp_path, act)


# -- who comes in between


@pytest.mark.parametrize(("fault", "why"), [("safeguard-stop", "Safeguard"), ("local-mode", "local mode")])
def test_a_fault_that_passes_while_the_end_is_written_keeps_it_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, why: str
) -> None:
    async def act(cell: ObjectCell) -> None:
        async def passing() -> None:
            cell.plant.controller.inject(fault)
            await cell.clock.sleep(0.2)
            cell.plant.controller.clear()
            await cell.clock.sleep(0.2)

        before(monkeypatch, "write_end", passing)
        await ends(cell, why)

    scene(tmp_path, act)


def test_an_end_that_takes_too_long_to_write_starts_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def act(cell: ObjectCell) -> None:
        before(monkeypatch, "write_end", lambda: cell.clock.sleep(20.5))
        await ends(cell, "was not started within 20 s")

    scene(tmp_path, act)


def test_what_is_too_late_right_before_the_controller_is_told_is_not_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[bool] = []

    async def at_once(self: ObjectArm, program: str, last_look: Callable[[], None]) -> None:
        monkeypatch.setattr("daemon.program_start.WITHIN_S", 0.1)
        last_look()
        played.append(True)

    monkeypatch.setattr(ObjectArm, "play_program", at_once)
    scene(tmp_path, lambda cell: ends(cell, "was not started within 0.1 s"))
    assert played == []


def test_what_another_client_loads_meanwhile_is_neither_started_nor_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load, stops = ObjectArm.load_program, []

    async def other(self: ObjectArm, program: str) -> None:
        await load(self, program)
        self.controller.loaded_program = "other.urp"

    async def stop(self: ObjectArm) -> None:
        stops.append(self.clock.now())

    monkeypatch.setattr(ObjectArm, "load_program", other)
    monkeypatch.setattr(ObjectArm, "stop_program", stop)
    scene(tmp_path, lambda cell: ends(cell, "has loaded other.urp"))
    assert stops == []
