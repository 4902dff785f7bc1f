"""The Structured Text that ships for PLCs, run cycle by cycle against the Modbus face of a cell.

Its words are read by a grammar that is not ours (blark), and it knows the daemon from the registers alone.
"""

import asyncio
from collections.abc import Callable
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from daemon.config import ModbusSection
from daemon.modbus import ModbusFace
from daemon.modbus.table import register_table
from daemon.plc import PlcFace
from fakes.object import VirtualClock, run_virtual
from tests.kit.laser_cell import committed_tool, laser_cell, laser_config
from tests.kit.laser_made import Solved, drawn_reference, solved
from tests.kit.modbus_face_rig import Plant, face_of
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.structured_text import Block, function_block

__all__ = ["no_report", "solved"]
pytestmark = pytest.mark.usefixtures("no_report")

SOURCE = files("daemon.modbus").joinpath("plc/cellward.st").read_text("utf-8")
CYCLE_S, CLIENT = 0.1, "192.0.2.1"
START, ABORT = 1, 3
CHECK, UPDATE = 3, 4


class Controller:
    """A PLC: reads the status block, calls its function block, writes the command block, in every cycle."""

    def __init__(self, face: ModbusFace, clock: VirtualClock, name: str = "FB_Cellward") -> None:
        self.face, self.program = face, function_block(SOURCE, name)
        self.reads = self.writes = True
        self.written: list[list[int]] = []
        self._clock = clock

    def __getattr__(self, name: str) -> Any:
        return self.program.values[name]

    async def cycles(self, until: Callable[["Controller"], Any], limit_s: float = 60.0) -> None:
        """Cycles until ``until`` is true after one of them."""
        async with asyncio.timeout(limit_s):
            while True:
                self.cycle()
                if until(self):
                    return
                await self._clock.sleep(CYCLE_S)

    def cycle(self) -> None:
        self.program.set("LinkOk", self.reads)
        if self.reads:
            self.program.set("Status", [int(word) for word in self.face.read_input(0, 64)])
        self.program.cycle(self._clock.now())
        block = list(self.program.values["Block"])
        self.written.append(block)
        if self.writes:
            self.face.write_holding(0, block, CLIENT)

    async def give(self, command: int, job: int = 0, argument: int = 0) -> None:
        """A rising edge at Execute, and cycles until the command is over."""
        for name, value in (("Command", command), ("Job", job), ("Argument1", argument)):
            self.program.set(name, value)
        await self.edge()
        await self.cycles(lambda plc: not plc.Busy)

    async def edge(self) -> None:
        for level in (False, True):
            self.program.set("Execute", level)
            self.cycle()
            await self._clock.sleep(CYCLE_S)


def with_face(script: Callable[[Plant, Controller], Any], last_sequence: int = 0, **plant_keys: Any) -> Plant:
    """A PLC at a face with a plant behind it."""
    plant = Plant(**plant_keys)

    async def main() -> None:
        clock = VirtualClock()
        face = face_of(plant, clock, last_sequence, allow_clients=["192.0.2.0/24"])
        plc = Controller(face, clock)
        await plc.cycles(lambda plc: plc.Alive)
        await script(plant, plc)

    run_virtual(main())
    return plant


def test_a_command_is_given_once_and_its_answer_read() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        await plc.give(START, CHECK, 70_000)
        assert (plc.Done, plc.Refused, plc.NoAnswer, plc.Reason) == (True, False, False, 0)
        await plc.cycles(lambda plc: len(plc.written) > 50)

    plant = with_face(script, last_sequence=65535)
    (command,) = plant.commands
    assert (command.code, command.sequence, command.job) == (START, 1, CHECK)
    assert command.argument_uint32 == 70_000


def test_a_refusal_is_told_by_the_number_of_its_error() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        await plc.give(START, CHECK)
        assert (plc.Done, plc.Refused, plc.Reason) == (False, True, 6001)

    with_face(script, answer=0x8000 + 6001)


def test_writes_that_are_lost_are_made_up_for_by_the_next_cycle() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        plc.program.set("Command", START)
        plc.writes = False
        await plc.edge()
        assert plant.commands == []
        plc.writes = True
        await plc.cycles(lambda plc: not plc.Busy)
        assert plc.Done

    assert [c.code for c in with_face(script).commands] == [START]


def test_a_command_that_nobody_heard_is_withdrawn_and_starts_nothing_later() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        plc.program.set("Command", START)
        plc.program.set("Job", CHECK)
        plc.writes = False
        await plc.edge()
        await plc.cycles(lambda plc: not plc.Busy)
        assert plc.NoAnswer
        plc.writes = True
        await plc.cycles(lambda plc: len(plc.written) > 400)
        assert plant.commands == [], "an old start was carried out"
        await plc.give(START, UPDATE)
        assert plc.Done

    plant = with_face(script)
    assert [(c.code, c.job) for c in plant.commands] == [(START, UPDATE)]


def test_without_a_link_nothing_is_given_and_nothing_is_kept_for_later() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        plc.reads = False
        await plc.cycles(lambda plc: not plc.Alive)
        await plc.give(START, CHECK)
        assert plc.NoAnswer
        plc.reads = True
        await plc.cycles(lambda plc: plc.Alive)
        await plc.cycles(lambda plc: len(plc.written) > 100)

    assert with_face(script).commands == []


def test_a_stop_goes_before_a_command_that_is_under_way() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        plc.program.set("Command", START)
        await plc.edge()
        plc.program.set("Stop", True)
        await plc.cycles(lambda plc: not plc.Busy)
        assert plc.Done

    plant = with_face(script, delay_s=8.0)
    assert [c.code for c in plant.commands] == [START, ABORT]
    assert plant.finished == [ABORT]


def test_a_plc_that_starts_anew_goes_on_from_the_last_sequence() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        again = Controller(plc.face, plc._clock)
        await again.cycles(lambda plc: plc.Alive)
        assert plant.commands == []
        await again.give(START, CHECK)
        assert again.Done

    plant = with_face(script, last_sequence=41)
    assert [c.sequence for c in plant.commands] == [42]


def test_the_heartbeat_moves_in_every_cycle() -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        plc.program.set("Enable", True)
        plc.program.set("NoNewPicks", True)
        await plc.cycles(lambda plc: len(plc.written) > 30)
        assert all(a[10] != b[10] for a, b in pairwise(plc.written))
        table = register_table()
        assert plc.written[-1][11] == table.bit("control", "enable") | table.bit("control", "no new picks")

    with_face(script)


@pytest.mark.parametrize(
    ("name", "register", "bit"),
    [
        ("Ready", "status", "ready"),
        ("JobRuns", "status", "busy"),
        ("JobDone", "status", "done"),
        ("Fault", "status", "fault"),
        ("Valid", "status", "result valid"),
    ],
)
def test_each_output_is_the_bit_of_the_table(name: str, register: str, bit: str) -> None:
    async def script(plant: Plant, plc: Controller) -> None:
        for level in (True, False):
            plant.status = register_table().bit(register, bit) if level else 0
            await plc._clock.sleep(CYCLE_S)
            plc.cycle()
            assert plc.program.values[name] is level

    with_face(script)


def test_addresses_in_the_text_are_those_of_the_table() -> None:
    at = {r.name: r.address for r in (*register_table().command, *register_table().status)}
    command = (
        "command",
        "sequence",
        "job",
        "argument_1",
        "argument_2",
        "argument_3",
        "plc_heartbeat",
        "control",
    )
    assert [at[name] for name in command] == [0, 1, 2, 4, 6, 8, 10, 11]
    status = ("status", "acknowledged_sequence", "result_code", "heartbeat", "error_code", "warning_bits")
    assert [at[name] for name in status] == [0, 1, 2, 3, 6, 7]
    assert (at["run_id"], at["prompt_id"]) == (10, 14)
    moved = [k for k, text in enumerate(_bits("warning_bits")) if "the tool has moved" in text]
    assert moved == [4]


def _bits(name: str) -> list[str]:
    (register,) = (r for r in register_table().status if r.name == name)
    return list(register.bits)


def plc_at(cell: ObjectCell, name: str) -> Controller:
    """A PLC at the face of this cell."""
    face = PlcFace(cell.config, cell.engine)
    section = ModbusSection.model_validate(
        {"bind": "127.0.0.1:0", "allow_write": True, "allow_clients": ["192.0.2.0/24"], "allow_accept": True}
    )
    served = ModbusFace(
        section,
        cell.clock,
        face.handle,
        face.snapshot,
        on_plc=face.heartbeat_changed,
        on_picks=face.picks_wanted_changed,
    )
    return Controller(served, cell.clock, name)


def test_the_example_finds_a_moved_tool_and_has_it_corrected(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-update", drawn_reference(config)) as cell:
            plc = plc_at(cell, "FB_ToolCheck")
            await plc.cycles(lambda plc: plc.Cell.values["Ready"])
            plc.program.set("Start", True)
            await plc.cycles(lambda plc: plc.Asks or plc.Failed, 600.0)
            assert not plc.Failed, plc.Reason
            assert committed_tool(cell) is None, "nothing is changed before a person confirms"
            plc.program.set("Confirm", True)
            await plc.cycles(lambda plc: plc.ToolTrue or plc.Failed, 600.0)
            assert not plc.Failed, plc.Reason
            assert committed_tool(cell) is not None
            assert [cell.folder(k).job for k in (1, 2)] == ["laser-check", "laser-update"]

    run_virtual(main())


@pytest.mark.parametrize("how", ["stop", "verdict"])
def test_the_example_tells_what_went_wrong(tmp_path: Path, solved: Solved, how: str) -> None:
    config = laser_config(tmp_path)
    solved.dp = [0.0, 0.0, 0.0]
    solved.verdict = "fail" if how == "verdict" else "pass"

    async def main() -> None:
        async with laser_cell(config, "laser-update", drawn_reference(config)) as cell:
            plc = plc_at(cell, "FB_ToolCheck")
            await plc.cycles(lambda plc: plc.Cell.values["Ready"])
            plc.program.set("Start", True)
            if how == "stop":
                await plc.cycles(lambda plc: plc.Cell.values["JobRuns"])
                plc.program.set("Stop", True)
            await plc.cycles(lambda plc: plc.ToolTrue or plc.Failed, 600.0)
            assert plc.Failed
            await plc.cycles(lambda plc: not plc.Cell.values["JobRuns"], 600.0)
            assert cell.at_rest()

    run_virtual(main())


def test_what_a_plc_cannot_hold_is_an_error_of_the_interpreter() -> None:
    text = "FUNCTION_BLOCK F\nVAR_INPUT\n n : UINT;\nEND_VAR\nn := n + 1;\nEND_FUNCTION_BLOCK"
    block: Block = function_block(text, "F")
    block.set("n", 65535)
    with pytest.raises(AssertionError, match="does not fit"):
        block.cycle(0.0)
