"""The arm's own program after a check that it asked for: when it is started, and what keeps it from that."""

import asyncio
from collections.abc import Awaitable, Callable
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pydantic import BaseModel

from cell.errors import error
from cell.procedure import Procedure, Run
from daemon import engine
from daemon.cli.status_text import status_text
from daemon.config import CellConfig, ConfigInvalid, load_config
from daemon.config.program_after import program_after_words
from daemon.modbus.command import ACCEPTED, Command
from daemon.plc import PlcFace
from daemon.start_request import StartRequest
from fakes.object import run_virtual
from fakes.object.arm import ObjectArm
from fakes.object.controller import Controller, Program
from tests.kit.laser_made import Solved
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell, refused, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

ROBOT, JOB = "192.168.1.20", "laser-check"
SERVER = {"allow_write": True, "allow_clients": [ROBOT]}
AFTER = f'\n[robot.program_after]\nprogram = "work.urp"\nasked_from = "{ROBOT}"\n'

Act = Callable[[ObjectCell], Awaitable[Any]]


class Step(StrEnum):
    LOOK = "look"
    END = "end"


class Check(Procedure):
    """Takes half a second and ends with ``verdict``; ``during`` is what happens meanwhile."""

    name, number, kind = JOB, 3, "laser"
    State = Step
    TRANSITIONS: ClassVar[dict[Any, Any]] = {None: frozenset({Step.LOOK}), Step.LOOK: frozenset({Step.END})}
    CHECKPOINTS = frozenset(Step)
    verdict: ClassVar[str] = "pass"
    during: ClassVar[Callable[[Run], Awaitable[Any]] | None] = None

    class Config(BaseModel): ...

    def uses(self) -> tuple[str, ...]:
        return ("arm",)

    async def run(self, run: Run) -> None:
        await run.enter(Step.LOOK)
        await run.clock.sleep(0.5)
        if self.during is not None:
            await type(self).during(run)  # type: ignore[misc]
        await run.enter(Step.END)
        run.result = Solved(verdict=self.verdict).current()

    async def dry_run(self, run: Run) -> dict[str, Any]:
        return {}


def config_of(folder: Path, after: str = AFTER, modbus: dict[str, Any] | None = None) -> CellConfig:
    write_config(folder, modbus=SERVER if modbus is None else modbus, arm_keys={"lost_after_s": 1.0})
    path = folder / "cell.toml"
    path.write_text(path.read_text("utf-8") + after, "utf-8")
    return load_config(path)


async def ask(
    cell: ObjectCell,
    job: type[Check] = Check,
    channel: str = "modbus",
    client: str = ROBOT,
    program: bool = True,
) -> int:
    """A program runs, asks as its last act, and has ended; the number of the run."""
    cell.engine.jobs = {job.name: job}
    controller = cell.plant.controller
    if program:
        controller.start_foreign()
    await cell.clock.sleep(0.2)
    controller.stop_program()
    if channel in ("modbus", "can"):
        command = Command(1, 7, job.number, 0, (0,) * 6, channel, client, False)
        assert await PlcFace(cell.config, cell.engine).handle(command) == ACCEPTED
    else:
        await cell.engine.start(StartRequest(job.name, {}, WHO, channel, client=client))
    assert cell.engine.run is not None
    return cell.engine.run.id


async def over(cell: ObjectCell) -> None:
    """The run has ended, and it is decided what becomes of the program."""
    start = cell.engine.program_start
    await cell.until(lambda: not cell.engine.active and start._task is None, "end")


async def starting(cell: ObjectCell) -> None:
    def told() -> bool:
        return (cell.engine.program_start.told or {}).get("state") == "starting"

    await cell.until(told, "start of the program")


def scene(folder: Path, act: Act, config: CellConfig | None = None) -> None:
    async def main() -> None:
        async with open_cell(config or config_of(folder)) as cell:
            await act(cell)

    run_virtual(main())


def not_started(cell: ObjectCell, run_id: int, why: str) -> None:
    """Nothing runs, and status, journal and command line say why."""
    told = cell.engine.status()["program_start"]
    assert (told["run_id"], told["state"]) == (run_id, "not started")
    assert why in told["text"]
    assert told["text"] in status_text(cell.engine.status())
    (line,) = cell.notes(run_id, "program of the arm not started")
    assert line["why"] == told["text"]
    assert cell.notes(run_id, "program of the arm started") == []
    assert cell.plant.controller.program is not Program.FOREIGN


def before(monkeypatch: pytest.MonkeyPatch, name: str, act: Callable[[], Awaitable[Any]]) -> None:
    """``act`` happens right before the engine calls its function ``name``."""
    function = getattr(engine, name)

    async def wrapped(*args: Any) -> Any:
        await act()
        return await function(*args)

    monkeypatch.setattr(f"daemon.engine.{name}", wrapped)


def with_check(**how: Any) -> type[Check]:
    return type("Made", (Check,), how)


async def ends(cell: ObjectCell, why: str, job: type[Check] = Check, **how: Any) -> None:
    run_id = await ask(cell, job, **how)
    await over(cell)
    not_started(cell, run_id, why)


# -- when it is started


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
        reported = self.world.reported.joints
        monkeypatch.setattr(
            self.world.reported, "joints", lambda t, q, qd: (reported(t, q, qd)[0] + 0.01, qd), raising=False
        )
        self._resting = None

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
        by = "the PLC's heartbeat" if verb == "heartbeat" else "the operator"
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
