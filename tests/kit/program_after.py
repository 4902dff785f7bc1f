"""A cell whose arm has a program of its own that asks for a check, and what became of that program."""

from collections.abc import Awaitable, Callable
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pydantic import BaseModel

from cell.procedure import Procedure, Run
from daemon import engine
from daemon.cli.status_text import status_text
from daemon.config import CellConfig, load_config
from daemon.modbus.command import ACCEPTED, Command
from daemon.plc import PlcFace
from daemon.start_request import StartRequest
from fakes.object import run_virtual
from fakes.object.controller import Program
from tests.kit.laser_made import Solved
from tests.kit.object_cell import WHO, ObjectCell, open_cell, write_config

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
    cell.engine.needs.jobs = {job.name: job}
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
