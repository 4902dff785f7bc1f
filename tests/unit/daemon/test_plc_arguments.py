"""Arguments of jobs from a PLC: what a job takes, what is refused, and what reaches the run."""

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cell.errors import catalogue
from daemon.config import ModbusSection
from daemon.job_arguments import PLACES, arguments_of, given_params
from daemon.modbus import Command, ModbusFace
from daemon.plc import PlcFace
from fakes.object import run_virtual
from procedures.kind import KINDS, Argument
from procedures.registry import JOBS
from procedures.slot.procedure import SlotInsertion
from tests.kit import slot_cell
from tests.kit.object_cell import ObjectCell, open_cell

START, HALT, SLOT_JOB = 1, 4, 9
CLIENT = "127.0.0.1"


def refusal(name: str) -> int:
    return 0x8000 | catalogue()[name].code


def float_bits(number: float) -> int:
    word: int = struct.unpack(">I", struct.pack(">f", number))[0]
    return word


class Panel:
    """A PLC that writes the command block of a whole cell, as its words arrive; no socket in between."""

    def __init__(self, cell: ObjectCell, **keys: Any) -> None:
        self.cell, self.audited = cell, list[tuple[Any, ...]]()
        plc = PlcFace(cell.config, cell.engine)
        section = ModbusSection(allow_write=True, allow_clients=[CLIENT], **keys)
        self.subject = ModbusFace(
            section, cell.clock, plc.handle, plc.snapshot, audit=lambda *line: self.audited.append(line)
        )
        self._sequence = 0

    async def start(self, *words: int) -> int:
        """Start the insertion with these argument registers; the result code."""
        self._sequence += 1
        registers = [START, self._sequence, SLOT_JOB, 0, *words, *[0] * (6 - len(words))]
        self.subject.write_holding(0, registers, CLIENT)
        read = self.subject.read_input
        await self.cell.until(lambda: read(1, 1) == [self._sequence], "the acknowledged sequence")
        return read(2, 1)[0]


async def what_ran(cell: ObjectCell) -> dict[str, Any]:
    """``run.json`` of the run under way, which is then halted."""
    run = cell.engine.running
    assert run is not None
    await cell.engine.halt("test")
    await cell.finished(run.id)
    return dict(cell.folder(run.id).info)


@pytest.mark.parametrize(("word_order", "words"), [("high-first", (0, 4, 0, 2)), ("low-first", (4, 0, 2, 0))])
def test_slot_and_action_of_a_start_are_those_of_its_run_alone(
    word_order: str, words: tuple[int, ...], tmp_path: Path
) -> None:
    async def main() -> None:
        async with open_cell(slot_cell.config(tmp_path)) as cell:
            slot_cell.give_hand_eye(cell)
            panel = Panel(cell, word_order=word_order)
            assert await panel.start(*words) == 1
            ran = await what_ran(cell)
            assert ran["parameters"] == {"slot": "4", "action": "pull"}
            assert (ran["job_config"]["slot"], ran["job_config"]["action"]) == (4, "pull")
            await cell.engine.reset("test")
            assert await panel.start() == 1
            ran = await what_ran(cell)
            assert (ran["job_config"]["slot"], ran["job_config"]["action"]) == (1, "insert"), "as configured"

    run_virtual(main())


def test_what_a_job_cannot_take_is_refused_with_its_code_and_audited(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(slot_cell.config(tmp_path)) as cell:
            slot_cell.give_hand_eye(cell)
            panel = Panel(cell)
            panel.subject._auditor.start()
            for words, name in (
                ((0, 7), "ARGUMENT_INVALID"),  # the rack has 6 slots
                ((1, 0), "ARGUMENT_INVALID"),  # 65536: no rack is that large
                ((0, 4, 0, 4), "ARGUMENT_INVALID"),  # there are three actions
                ((0, 4, 0, 1, 0, 1), "NOT_IN_VERSION"),  # there is no third argument
            ):
                assert await panel.start(*words) == refusal(name)
            assert not cell.engine.active
            assert list(cell.runs.iterdir()) == []
            await panel.subject._auditor.stop()
            refused = [line for line in panel.audited if not line[2]]
            assert [line[1] for line in refused] == [f"command 1 sequence {n} job 9" for n in range(1, 5)]

    run_virtual(main())


def test_the_argument_of_a_can_frame_means_what_the_first_registers_mean(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(slot_cell.config(tmp_path)) as cell:
            slot_cell.give_hand_eye(cell)
            plc = PlcFace(cell.config, cell.engine)
            for slot, result in ((7, refusal("ARGUMENT_INVALID")), (6, 1)):
                words = (slot >> 16, slot & 0xFFFF, 0, 0, 0, 0)  # as daemon/can/face.py has them
                assert await plc.handle(Command(START, slot, SLOT_JOB, 0, words, "can")) == result
            assert (await what_ran(cell))["parameters"] == {"slot": "6"}

    run_virtual(main())


def test_numbers_with_a_fraction_are_read_as_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    own = (Argument("sigma_m", 1, "float32"), Argument("slot", 3))
    monkeypatch.setitem(KINDS, "slot", replace(KINDS["slot"], arguments=own))  # type: ignore[arg-type]
    assert given_params(SlotInsertion, (float_bits(0.25), 0, 3)) == {"sigma_m": "0.25", "slot": "3"}
    assert given_params(SlotInsertion, (float_bits(-0.0), 0, 0)) == {}
    with pytest.raises(Exception, match=r"argument_1 \(sigma_m\) is no number"):
        given_params(SlotInsertion, (float_bits(float("nan")), 0, 0))
    with pytest.raises(Exception, match="slot-insertion takes no argument_2, which must be 0"):
        given_params(SlotInsertion, (0, 1, 0))


@pytest.mark.parametrize("job", sorted(JOBS))
def test_what_a_job_declares_can_be_given(job: str) -> None:
    subject = arguments_of(JOBS[job])
    places = [argument.place for argument in subject]
    assert places == list(range(1, len(places) + 1)), "without a gap, the first for CAN"
    assert len(places) <= PLACES
    schema = json.loads(json.dumps(JOBS[job].Config.model_json_schema()))["properties"]
    for argument in subject:
        kind = {"integer": "uint32", "number": "float32"}.get(schema[argument.key].get("type"), "uint32")
        assert argument.type == kind
        assert list(argument.words) == schema[argument.key].get("enum", []), "every word, in its order"
