"""A robot program that asks for a check of its tool: the shipped URScript on the twin's controller.

The controller's Modbus client is played by a real client of the real server.
"""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, ClassVar

import pytest

from cell.errors import CellError
from daemon.modbus import Command, register_table
from daemon.modbus.plc_files import robot_script
from daemon.start_request import StartRequest
from fakes.object import run_virtual
from fakes.ur.runtime import RuntimeState
from fakes.ur.script_functions import ScriptFunctions
from tests.kit.cli_harness import CommandLine
from tests.kit.fake_ur_stepped import Stepped
from tests.kit.modbus_face_rig import Client, Plant, connect, face_of
from tests.kit.object_cell import open_cell, write_config

CYCLES_S = 0.1  # the controller sends and reads its signals ten times a second
DONE, VALID, FAULT, BUSY, MOVED = 1 << 2, 1 << 6, 1 << 3, 1 << 1, 1 << 4


class Signals:
    """The Modbus client of a controller, with the signals that the head of the script asks for."""

    OUTPUTS: ClassVar = {"cw_command": 0, "cw_sequence": 1, "cw_job": 2, "cw_control": 11}
    INPUTS: ClassVar = {"cw_status": 0, "cw_answered": 1, "cw_code": 2, "cw_warnings": 7}

    def __init__(self, client: Client) -> None:
        self.client = client
        self.values = dict.fromkeys((*self.OUTPUTS, *self.INPUTS), 0)
        self.unsent: list[str] = []

    def set(self, name: str, value: int) -> None:
        assert name in self.OUTPUTS
        self.values[name] = int(value)
        self.unsent.append(name)

    async def exchange(self) -> None:
        """Each output by itself (function 6), the last one set first: the controller promises no order."""
        while self.unsent:
            name = self.unsent.pop()
            sent = f"06{self.OUTPUTS[name]:04x}{self.values[name]:04x}"
            assert await self.client.ask(sent) == sent
        for name, address in self.INPUTS.items():
            (self.values[name],) = await self.client.words(address, 1)


class Checked(Plant):
    """A daemon whose checks end as they are told to; it notes whether a program ran on the arm."""

    def __init__(self, robot: Stepped, **ends: Any) -> None:
        super().__init__(**ends)
        self.robot, self.warnings, self.programs = robot, 0, list[bool]()

    async def handle(self, command: Command) -> int:
        self.programs.append(self.robot.robot.runtime.state == RuntimeState.PLAYING)
        return await super().handle(command)

    def snapshot(self) -> dict[str, Any]:
        return super().snapshot() | {"warning_bits": self.warnings}


@pytest.fixture
def robot() -> Stepped:
    return Stepped()


Play = Callable[[Callable[[Signals], Awaitable[None]], Checked], None]


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch) -> Play:
    """Runs a scene with the controller's Modbus client connected to the daemon's server."""

    def run(scene: Callable[[Signals], Awaitable[None]], plant: Checked) -> None:
        async def whole() -> None:
            face = face_of(plant, last_sequence=65535)
            await face.start()
            client = await connect(face)
            signals = Signals(client)

            def setter(self: Any, name: str, value: int, secondary: bool) -> None:
                signals.set(name, value)

            def getter(self: Any, name: str, secondary: bool) -> int:
                return signals.values[name]

            monkeypatch.setattr(ScriptFunctions, "modbus_set_output_register", setter, raising=False)
            monkeypatch.setattr(ScriptFunctions, "modbus_get_signal_status", getter, raising=False)
            try:
                await signals.exchange()
                await scene(signals)
            finally:
                await client.close()
                await face.stop()

        asyncio.run(whole())

    return run


async def run_program(robot: Stepped, signals: Signals, last: str) -> None:
    """The shipped functions and one more line, until the program has ended and the client has sent all."""
    robot.scripts.take(f"def work():\n{robot_script()}{last}\nend\n")
    for _ in range(60):
        robot.run(CYCLES_S)
        await signals.exchange()
    assert robot.robot.runtime.state == RuntimeState.STOPPED
    assert [event for event, _, failure in robot.events if failure] == []


async def answered(signals: Signals, sequence: int) -> None:
    """Until the daemon's answer has reached the signals: a write is answered before it is carried out."""
    for _ in range(500):
        await signals.exchange()
        if signals.values["cw_answered"] == sequence:
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"command {sequence} was not answered in 5 s: {signals.values}")


def test_the_question_is_the_last_act_of_the_program_and_starts_one_check(robot: Stepped, play: Play) -> None:
    plant = Checked(robot)

    async def scene(signals: Signals) -> None:
        for asked in (1, 2):
            await run_program(robot, signals, 'cellward_check_tool()\ntextmsg("went on")')
            await answered(signals, asked)

    play(scene, plant)
    assert [(c.code, c.job, c.sequence) for c in plant.commands] == [(1, 3, 1), (1, 3, 2)]
    assert plant.programs == [False, False]
    assert robot.messages == []


@pytest.mark.parametrize(
    ("answer", "status", "warnings", "true"),
    [
        (1, DONE | VALID, 0, True),
        (1, DONE | VALID, MOVED, False),
        (1, DONE, 0, False),
        (1, DONE | VALID | FAULT, 0, False),
        (1, BUSY, 0, False),
        (0x8000 | 3001, DONE | VALID, 0, False),
    ],
)
def test_the_program_that_starts_again_learns_what_the_check_came_to(
    robot: Stepped, play: Play, answer: int, status: int, warnings: int, true: bool
) -> None:
    plant = Checked(robot, answer=answer)

    async def scene(signals: Signals) -> None:
        await run_program(robot, signals, "cellward_check_tool()")
        await answered(signals, 1)
        plant.status, plant.warnings = status, warnings
        await run_program(robot, signals, "textmsg(cellward_tool_is_true())")

    play(scene, plant)
    assert robot.messages == [str(true)]


def test_without_a_question_there_is_no_answer(robot: Stepped, play: Play) -> None:
    """The result of somebody else's check, before this robot ever asked."""

    async def scene(signals: Signals) -> None:
        await run_program(robot, signals, "textmsg(cellward_tool_is_true())")

    play(scene, Checked(robot, status=DONE | VALID))
    assert robot.messages == ["False"]


def test_the_bits_and_addresses_of_the_script_are_those_of_the_register_table() -> None:
    table = register_table()
    named = {register.name: register for register in (*table.command, *table.status)}
    assert [named[name].address for name in ("command", "sequence", "job", "control")] == [0, 1, 2, 11]
    read = ("status", "acknowledged_sequence", "result_code", "warning_bits")
    assert [named[name].address for name in read] == [0, 1, 2, 7]
    assert named["job"].values[3] == "laser-check"
    assert [named["status"].bits[bit] for bit in (2, 3, 6)] == ["done", "fault", "result valid"]
    assert "moved" in named["warning_bits"].bits[4]
    assert named["control"].bits[0] == "enable"


@pytest.mark.parametrize(("runs_on_s", "refused"), [(0.3, None), (0.8, "ARM_PROGRAM_RUNNING")])
def test_a_program_that_asks_has_half_a_second_to_end(
    tmp_path: Path, runs_on_s: float, refused: str | None
) -> None:
    async def scene() -> str | None:
        async with open_cell(write_config(tmp_path)) as cell:
            arm = cell.supervisor.devices["arm"].device
            arm.inject("foreign-program")  # type: ignore[attr-defined]

            async def end() -> None:
                await cell.clock.sleep(runs_on_s)
                arm.inject("clear")  # type: ignore[attr-defined]

            ending = asyncio.create_task(end())
            try:
                await cell.engine.start(StartRequest("cone-capture", {}, "robot", "modbus"))
            except CellError as exc:
                return exc.name
            finally:
                await ending
            return None  # leaving the cell halts what runs

    assert run_virtual(scene()) == refused


def test_the_script_comes_with_the_files_for_a_plc(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert CommandLine(monkeypatch, capsys, tmp_path)("plc-files", tmp_path / "plc").code == 0
    assert (tmp_path / "plc/cellward.script").read_text("utf-8") == robot_script()
