"""The arm's own program after a check that it asked for: when it is started, and after what it is not."""

from pathlib import Path
from typing import Any

import pytest

from cell.errors import error
from cell.procedure import Run
from daemon.config import ConfigInvalid
from daemon.start_request import StartRequest
from daemon.words.program_after_text import program_after_words
from fakes.object import run_virtual
from fakes.object.controller import Program
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell, refused
from tests.kit.program_after import (
    AFTER,
    JOB,
    ROBOT,
    ask,
    config_of,
    ends,
    not_started,
    over,
    scene,
    starting,
    with_check,
)

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def test_the_program_that_asked_is_loaded_and_started_again_after_a_pass(tmp_path: Path) -> None:
    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        told = cell.engine.status()["program_start"]
        assert (told["state"], told["program"]) == ("asked", "work.urp")
        await starting(cell)
        assert cell.engine.status()["packml"] == "COMPLETE"  # the program reads this as its first act
        assert cell.plant.controller.program is Program.NONE
        await over(cell)
        controller = cell.plant.controller
        assert (controller.program, controller.loaded_program) == (Program.FOREIGN, "work.urp")
        assert cell.engine.status()["program_start"]["state"] == "started"
        assert len(cell.notes(run_id, "program of the arm started")) == 1
        assert cell.end(run_id)["outcome"] == "complete"
        assert (await refused(cell.engine.start(StartRequest(JOB, {}, WHO, "control")))).name == (
            "ARM_PROGRAM_RUNNING"
        )
        controller.stop_program()
        await cell.engine.start(StartRequest(JOB, {}, WHO, "control"))
        assert cell.engine.status()["program_start"] is None, "of another run"

    scene(tmp_path, act)


# -- who asks


@pytest.mark.parametrize(
    "how",
    [
        {"channel": "control", "client": ""},
        {"channel": "web"},
        {"channel": "can"},
        {"client": "192.168.1.21"},
    ],
)
def test_what_somebody_else_asked_for_starts_nothing(tmp_path: Path, how: dict[str, str]) -> None:
    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell, **how)
        await over(cell)
        assert cell.end(run_id)["verdict"] == "pass"
        assert cell.engine.status()["program_start"] is None
        assert cell.plant.controller.program is Program.NONE

    scene(tmp_path, act)


def test_without_the_table_nothing_is_started(tmp_path: Path) -> None:
    async def act(cell: ObjectCell) -> None:
        await ask(cell)
        await over(cell)
        assert cell.engine.status()["program_start"] is None
        assert cell.plant.controller.program is Program.NONE

    scene(tmp_path, act, config_of(tmp_path, after=""))


def test_a_question_without_a_program_that_ran_is_none_of_a_program(tmp_path: Path) -> None:
    scene(tmp_path, lambda cell: ends(cell, "no program ran on the arm", program=False))


def test_our_own_program_of_the_run_before_is_not_taken_for_one_that_asks(tmp_path: Path) -> None:
    async def act(cell: ObjectCell) -> None:
        async def ours(run: Run) -> None:
            cell.plant.controller.start_ours()
            await run.clock.sleep(0.2)
            cell.plant.controller.stop_program()

        await ask(cell, with_check(during=staticmethod(ours)), channel="control")
        await over(cell)
        await ends(cell, "no program ran on the arm", program=False)

    scene(tmp_path, act)


def test_after_another_job_nothing_is_started(tmp_path: Path) -> None:
    scene(tmp_path, lambda cell: ends(cell, "only after a laser-check", with_check(name="laser-update")))


# -- how the run ended


@pytest.mark.parametrize("verdict", ["warn", "fail"])
def test_after_a_check_that_did_not_pass_nothing_is_started(tmp_path: Path, verdict: str) -> None:
    scene(tmp_path, lambda cell: ends(cell, f"its verdict is {verdict}", with_check(verdict=verdict)))


@pytest.mark.parametrize(("verb", "outcome"), [("abort", "stopped"), ("halt", "halted")])
def test_after_a_run_that_was_stopped_nothing_is_started(tmp_path: Path, verb: str, outcome: str) -> None:
    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await getattr(cell.engine, verb)(WHO)
        await over(cell)
        not_started(cell, run_id, f"the run ended {outcome}")

    scene(tmp_path, act)


def test_after_a_run_that_failed_nothing_is_started(tmp_path: Path) -> None:
    async def fail(run: Run) -> None:
        raise error("ARM_MOVED", "somebody pushed it")

    scene(tmp_path, lambda cell: ends(cell, "the run ended aborted", with_check(during=staticmethod(fail))))


@pytest.mark.parametrize("fault", ["protective-stop", "emergency-stop", "safeguard-stop"])
def test_after_a_stop_of_the_safety_system_nothing_is_started(tmp_path: Path, fault: str) -> None:
    async def act(cell: ObjectCell) -> None:
        async def stop(run: Run) -> None:
            cell.plant.controller.inject(fault)
            await run.clock.sleep(0.5)

        await ends(cell, "the run ended aborted", with_check(during=staticmethod(stop)))

    scene(tmp_path, act)


def test_after_a_run_that_somebody_held_nothing_is_started(tmp_path: Path) -> None:
    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await cell.engine.pause(WHO)
        await cell.clock.sleep(1.0)
        await cell.engine.resume(WHO)
        await over(cell)
        assert cell.end(run_id)["verdict"] == "pass"
        not_started(cell, run_id, "somebody held it")

    scene(tmp_path, act)


def test_after_a_run_with_a_silence_nothing_is_started(tmp_path: Path) -> None:
    async def silent(run: Run) -> None:
        times = iter((True, False))

        async def look() -> None:
            if next(times):
                raise error("STALE_DATA", "for a moment")

        await run.take_step("look", look)

    job = with_check(during=staticmethod(silent))
    scene(tmp_path, lambda cell: ends(cell, "a device was silent during it (1 step taken again)", job))


def test_a_run_whose_end_cannot_be_written_starts_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def act(cell: ObjectCell) -> None:
        async def unwritten(*_: Any) -> Any:
            return error("DISK_FULL", "end.json")

        monkeypatch.setattr("daemon.engine.write_end", unwritten)
        await ask(cell)
        await over(cell)
        told = cell.engine.status()["program_start"]
        assert (told["state"], "end.json" in told["text"]) == ("not started", True)
        assert cell.plant.controller.program is Program.NONE

    scene(tmp_path, act)


# -- what the arm shows then


def test_no_job_begins_while_it_is_being_started(tmp_path: Path) -> None:
    async def act(cell: ObjectCell) -> None:
        await ask(cell)
        await starting(cell)
        refusal = await refused(cell.engine.start(StartRequest(JOB, {}, WHO, "control")))
        assert (refusal.name, "work.urp" in str(refusal)) == ("BUSY", True)
        await over(cell)
        assert cell.engine.status()["program_start"]["state"] == "started"

    scene(tmp_path, act)


def test_the_end_of_the_daemon_keeps_it_from_starting_and_the_next_one_knows_of_nothing(
    tmp_path: Path,
) -> None:
    config = config_of(tmp_path)

    async def act(cell: ObjectCell) -> None:
        run_id = await ask(cell)
        await starting(cell)
        await cell.engine.shutdown()
        not_started(cell, run_id, "stopped by the end of the daemon")

    scene(tmp_path, act, config)

    async def next_one(cell: ObjectCell) -> None:
        await cell.clock.sleep(5.0)
        assert cell.engine.status()["program_start"] is None
        assert cell.plant.controller.program is Program.NONE

    scene(tmp_path, next_one, config)


def test_a_daemon_that_was_killed_during_the_check_starts_nothing(tmp_path: Path) -> None:
    config = config_of(tmp_path)

    async def main() -> None:
        async with open_cell(config) as cell:
            await ask(cell)
            await cell.kill()

    run_virtual(main())

    async def next_one(cell: ObjectCell) -> None:
        await cell.clock.sleep(5.0)
        assert cell.engine.interrupted == [1]
        assert cell.engine.status()["program_start"] is None
        assert cell.plant.controller.program is Program.NONE

    scene(tmp_path, next_one, config)


# -- what cell.toml may say


def test_check_says_in_words_that_the_arm_will_move(tmp_path: Path) -> None:
    words = program_after_words(config_of(tmp_path))
    assert words is not None
    assert f"the robot at {ROBOT}" in words
    assert "loads 'work.urp' on 'arm' and starts it: the arm MOVES" in words
    assert program_after_words(config_of(tmp_path, after="")) is None


@pytest.mark.parametrize(
    ("after", "modbus", "says"),
    [
        (
            AFTER,
            {},
            "robot.program_after.asked_from: no robot can ask: set enabled and allow_write in [modbus]",
        ),
        (
            AFTER,
            {"allow_write": True, "allow_clients": ["10.0.0.0/8"]},
            "is not in allow_clients of [modbus]",
        ),
        (AFTER.replace(ROBOT, "the robot"), None, "robot.program_after.asked_from"),
        (AFTER.replace("work.urp", "work.urp\\nplay"), None, "robot.program_after.program"),
        (AFTER.replace("work.urp", "work.script"), None, "robot.program_after.program"),
    ],
)
def test_a_table_that_cannot_work_is_refused(
    tmp_path: Path, after: str, modbus: dict[str, Any] | None, says: str
) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        config_of(tmp_path, after, modbus)
    assert any(says in finding for finding in caught.value.findings), caught.value.findings
