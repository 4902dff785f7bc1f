"""The engine as a PLC sees it: commands with result codes, status bits, and what a lost heartbeat does."""

import asyncio
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError, catalogue
from cell.packml import PackML
from daemon.config import CellConfig
from daemon.modbus import Command
from daemon.plc import PlcFace
from fakes.object import run_virtual
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell, refused, write_config
from tests.kit.warnings_shown import warnings_shown

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

START, FINISH, ABORT, HALT, PAUSE, RESUME, RESET, ACCEPT, ACKNOWLEDGE, CONFIRM, SKIP = range(1, 12)
ACCEPTED = 1
READY, BUSY, DONE, FAULT, WARNING, RESULT_VALID = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 4, 1 << 6
ARM_OK, CAMERA_OK, STOPPED_BY_SAFETY, TWIN = 1 << 7, 1 << 8, 1 << 13, 1 << 14


class Panel:
    """A PLC's program: sends commands and reads the status block."""

    def __init__(self, cell: ObjectCell) -> None:
        self.cell = cell
        self.subject = PlcFace(cell.config, cell.engine)
        self._sequence = count(1)

    async def send(self, code: int, job: int = 0, number: int = 0) -> int:
        args = (number >> 16, number & 0xFFFF, 0, 0, 0, 0)
        return await self.subject.handle(Command(code, next(self._sequence), job=job, args=args))

    def read(self, name: str) -> Any:
        return self.subject.snapshot()[name]

    def has(self, bit: int) -> bool:
        return bool(self.read("status") & bit)

    async def start_placed(self) -> None:
        """Start, and confirm that the board stands where the first placement is to be."""
        assert await self.send(START, job=1) == ACCEPTED
        await self.cell.until(lambda: self.read("prompt_id"), "a prompt")
        assert await self.send(CONFIRM, number=self.read("prompt_id")) == ACCEPTED

    async def run_to_the_end(self, placements: int = 1) -> None:
        """Start, and confirm each prompt by the register that shows it."""
        await self.start_placed()
        for _ in range(placements - 1):
            await self.cell.until(lambda: self.read("prompt_id"), "a prompt")
            self.cell.plant.world.operator.move_on(self.cell.clock.now())
            assert await self.send(CONFIRM, number=self.read("prompt_id")) == ACCEPTED
        await self.cell.until(lambda: not self.has(BUSY), "the end")


def refusal(name: str) -> int:
    return 0x8000 | catalogue()[name].code


def with_modbus(config: CellConfig, **keys: Any) -> CellConfig:
    return config.model_copy(update={"modbus": config.modbus.model_copy(update=keys)})


def on_a_panel(config: CellConfig, script: Any) -> None:
    async def main() -> None:
        async with open_cell(config) as cell:
            await script(cell, Panel(cell))

    run_virtual(main())


def test_a_plc_runs_a_whole_job_and_reads_what_came_of_it(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        assert (panel.has(READY), panel.has(BUSY), panel.has(TWIN)) == (True, False, True)
        assert panel.has(ARM_OK)
        assert panel.has(CAMERA_OK)
        assert panel.read("packml_state") == PackML.IDLE
        assert await panel.send(START, job=1) == ACCEPTED
        assert panel.has(BUSY)
        assert not panel.has(READY)
        assert (panel.read("active_job"), panel.read("run_id")) == (1, 1)
        await cell.until(lambda: panel.read("prompt_id"), "a prompt")
        assert await panel.send(CONFIRM, number=panel.read("prompt_id")) == ACCEPTED
        await cell.until_state("settle")
        assert (panel.read("step"), panel.read("steps")) == (0, 8)
        await cell.until(lambda: panel.read("prompt_id"), "a prompt")
        assert (panel.read("packml_state"), panel.read("step")) == (PackML.HELD, 4)
        cell.plant.world.operator.move_on(cell.clock.now())
        assert await panel.send(CONFIRM, number=panel.read("prompt_id")) == ACCEPTED
        assert panel.read("prompt_id") == 0
        await cell.until(lambda: not panel.has(BUSY), "the end")
        assert panel.has(DONE)
        assert panel.has(RESULT_VALID)
        assert not panel.has(FAULT)
        assert (panel.read("packml_state"), panel.read("run_id"), panel.read("active_job")) == (17, 1, 0)
        result = cell.result(1)
        assert panel.read("spread_within_m") == result["result"]["spread_within"]["t_norm"] > 0.0
        assert panel.read("spread_across_m") == result["result"]["spread_across"]["t_norm"] > 0.0
        assert panel.read("predicted_95_m") == result["uncertainty"]["error95_t_m"] > 0.0
        assert panel.read("config_checksum") == cell.config.checksum
        assert panel.read("protocol_version") == 0x0100

    on_a_panel(write_config(tmp_path, job={"placements": 2}), script)


def test_the_whole_configuration_is_not_gone_through_for_every_poll(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        told = cell.config.checksum
        monkeypatch.setattr(CellConfig, "part_of_a_run", lambda config: pytest.fail("made again"))
        assert panel.read("config_checksum") == told
        monkeypatch.undo()

    on_a_panel(write_config(tmp_path), script)


def test_result_bits_stay_until_they_are_acknowledged(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.run_to_the_end()
        await cell.clock.sleep(3600.0)
        assert panel.has(RESULT_VALID)
        assert panel.read("run_id") == 1
        assert await panel.send(ACKNOWLEDGE) == ACCEPTED
        assert not panel.has(RESULT_VALID)
        assert not panel.has(DONE)
        assert (panel.read("run_id"), panel.read("predicted_95_m")) == (0, 0.0)
        await panel.run_to_the_end()
        assert panel.has(RESULT_VALID)
        assert panel.read("run_id") == 2

    on_a_panel(write_config(tmp_path), script)


def test_figures_of_the_last_run_are_not_shown_beside_the_number_of_the_next(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.run_to_the_end()
        assert panel.has(RESULT_VALID)
        assert panel.read("predicted_95_m") > 0.0
        assert await panel.send(START, job=1) == ACCEPTED
        assert panel.read("run_id") == 2
        assert panel.has(BUSY)
        assert not panel.has(RESULT_VALID)
        assert panel.read("predicted_95_m") == 0.0
        assert await panel.send(ABORT) == ACCEPTED
        await cell.until(lambda: not panel.has(BUSY), "the end")
        assert (panel.read("run_id"), panel.read("predicted_95_m")) == (2, 0.0)

    on_a_panel(write_config(tmp_path), script)


def test_a_run_that_solved_nothing_shows_no_result(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.start_placed()
        await cell.until_state("move")
        assert await panel.send(ABORT) == ACCEPTED
        await cell.until(lambda: not panel.has(BUSY), "the end")
        assert panel.read("packml_state") == PackML.STOPPED
        assert not panel.has(RESULT_VALID)
        assert not panel.has(DONE)
        assert cell.at_rest()

    on_a_panel(write_config(tmp_path), script)


@pytest.mark.parametrize(
    ("code", "job", "number", "name"),
    [
        (START, 99, 0, "UNKNOWN_JOB"),
        (FINISH, 0, 0, "NOT_NOW"),
        (ABORT, 0, 0, "NOT_NOW"),
        (HALT, 0, 0, "NOT_NOW"),
        (PAUSE, 0, 0, "NOT_NOW"),
        (RESUME, 0, 0, "NOT_NOW"),
        (CONFIRM, 0, 77, "NOT_NOW"),
        (ACCEPT, 0, 1, "NOT_ALLOWED"),
        (0, 0, 0, "ARGUMENT_INVALID"),
        (SKIP, 0, 77, "NOT_NOW"),
        (12, 0, 0, "ARGUMENT_INVALID"),
    ],
)
def test_a_command_that_cannot_be_carried_out_comes_back_with_the_number_of_the_reason(
    code: int, job: int, number: int, name: str, tmp_path: Path
) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        assert await panel.send(code, job, number) == refusal(name)
        assert list(cell.runs.iterdir()) == []

    on_a_panel(write_config(tmp_path), script)


def test_a_second_start_is_refused_as_busy_and_a_wrong_prompt_confirms_nothing(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.send(START, job=1)
        assert await panel.send(START, job=1) == refusal("BUSY")
        await cell.until(lambda: panel.read("prompt_id"), "a prompt")
        open_prompt = panel.read("prompt_id")
        assert await panel.send(CONFIRM, number=open_prompt + 1) == refusal("NOT_NOW")
        assert panel.read("prompt_id") == open_prompt
        assert await panel.send(HALT) == ACCEPTED

    on_a_panel(write_config(tmp_path, job={"placements": 2}), script)


def test_pause_resume_and_finish_reach_the_job(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.start_placed()
        await cell.until_state("settle")
        assert await panel.send(PAUSE) == ACCEPTED
        await cell.until(lambda: panel.read("packml_state") == PackML.HELD, "Held")
        assert await panel.send(RESUME) == ACCEPTED
        await cell.until_state("capture")
        assert await panel.send(FINISH) == ACCEPTED
        await cell.until(lambda: not panel.has(BUSY), "the end")
        assert panel.read("packml_state") == PackML.COMPLETE
        assert len(cell.poses(1)) < 4

    on_a_panel(write_config(tmp_path), script)


def test_accepting_needs_the_configuration_and_a_result_that_waits(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.run_to_the_end()
        assert await panel.send(ACCEPT, number=55) == refusal("NOT_NOW")
        assert await panel.send(ACCEPT, number=1) == ACCEPTED
        (result,) = cell.ledger.results()
        assert (result["state"], result["who"]) == ("committed", "modbus ")
        assert await panel.send(ACCEPT, number=1) == refusal("NOT_NOW")

    on_a_panel(with_modbus(write_config(tmp_path), allow_accept=True), script)


def test_a_protective_stop_shows_its_bits_and_code_until_the_reset(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.start_placed()
        await cell.until_state("move")
        cell.plant.controller.inject("protective-stop")
        await cell.until(lambda: not panel.has(BUSY), "the end")
        assert panel.has(FAULT)
        assert panel.has(STOPPED_BY_SAFETY)
        assert not panel.has(READY)
        assert panel.read("error_code") == catalogue()["ARM_PROTECTIVE_STOP"].code
        assert panel.read("packml_state") == PackML.ABORTED
        assert await panel.send(RESET) == refusal("NOT_NOW")
        cell.plant.controller.clear()
        await cell.clock.sleep(0.1)
        assert await panel.send(START, job=1) == refusal("MOTION_LATCHED")
        assert await panel.send(RESET) == ACCEPTED
        assert (panel.has(FAULT), panel.has(STOPPED_BY_SAFETY)) == (False, False)
        assert (panel.read("error_code"), panel.read("packml_state")) == (0, PackML.IDLE)
        assert panel.has(READY)

    on_a_panel(write_config(tmp_path), script)


def test_what_ended_a_run_is_shown_while_its_answer_is_still_being_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = 20.0  # s

    async def script(cell: ObjectCell, panel: Panel) -> None:
        async def keep_answer(*_: object) -> bool:
            await cell.clock.sleep(held)
            return False

        monkeypatch.setattr("daemon.engine.keep_answer", keep_answer)
        told: list[int] = []
        await panel.start_placed()
        await cell.until_state("move")
        cell.engine.subscribe(lambda: told.append(panel.read("error_code")))
        code = catalogue()["ARM_PROTECTIVE_STOP"].code
        cell.plant.controller.inject("protective-stop")
        await cell.until(lambda: panel.read("error_code") == code, "the code", 1.0)
        assert code in told, "and it was published"
        assert (panel.has(FAULT), panel.has(BUSY), panel.has(READY)) == (True, True, False)
        assert panel.read("packml_state") == PackML.ABORTING
        for asked in (cell.engine.reset, cell.engine.abort, cell.engine.pause):
            assert "its end is being written" in str(await refused(asked(WHO)))
        assert panel.read("error_code") == code
        await cell.until(lambda: not panel.has(BUSY), "the end", 2.0 * held)
        assert panel.read("packml_state") == PackML.ABORTED

    on_a_panel(write_config(tmp_path), script)


def test_a_button_pressed_while_no_job_runs_shows_too(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        cell.plant.controller.inject("emergency-stop")
        await cell.clock.sleep(0.1)
        assert panel.has(STOPPED_BY_SAFETY)
        assert not panel.has(READY)
        assert not panel.has(ARM_OK)
        cell.plant.controller.clear()
        await cell.clock.sleep(0.1)
        assert not panel.has(STOPPED_BY_SAFETY)
        assert panel.has(READY)

    on_a_panel(write_config(tmp_path), script)


def test_a_lost_device_takes_its_bit_and_ready_away(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        cell.plant.camera.inject("refuse")
        await cell.clock.sleep(0.1)
        assert (panel.has(ARM_OK), panel.has(CAMERA_OK)) == (True, False)
        assert warnings_shown(panel.read("warning_bits")) == ["device_not_ready"]
        cell.plant.controller.inject("refuse")
        await cell.clock.sleep(0.1)
        assert (panel.has(ARM_OK), panel.has(READY)) == (False, False)

    on_a_panel(write_config(tmp_path), script)


def test_a_lost_heartbeat_holds_the_job_and_its_return_does_not_resume_it(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        panel.subject.heartbeat_changed(False)  # nothing runs, nothing happens
        await panel.start_placed()
        await cell.until_state("settle")
        panel.subject.heartbeat_changed(False)
        await cell.until(lambda: panel.read("packml_state") == PackML.HELD, "Held")
        panel.subject.heartbeat_changed(True)
        await cell.clock.sleep(60.0)
        assert panel.read("packml_state") == PackML.HELD
        assert cell.at_rest()
        assert "heartbeat" in cell.notes(1, "pause")[0]["who"]
        assert await panel.send(RESUME) == ACCEPTED
        assert (await cell.finished(1))["outcome"] == "complete"

    on_a_panel(write_config(tmp_path), script)


def test_a_heartbeat_lost_while_the_run_is_being_made_holds_that_run_alone(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        starting = asyncio.create_task(panel.send(START, job=1))
        await asyncio.sleep(0)  # the start now waits for the ledger
        assert not cell.engine.active
        panel.subject.heartbeat_changed(False)
        panel.subject.heartbeat_changed(True)
        assert await starting == ACCEPTED
        await cell.until(lambda: panel.read("packml_state") == PackML.HELD, "Held")
        await cell.clock.sleep(60.0)
        assert panel.read("packml_state") == PackML.HELD
        assert cell.notes(1, "lease") == []
        assert "heartbeat" in cell.notes(1, "pause")[0]["who"]
        assert await panel.send(RESUME) == ACCEPTED
        assert (await cell.finished(1))["outcome"] == "complete"
        await panel.run_to_the_end()
        assert cell.notes(2, "pause") == []

    on_a_panel(write_config(tmp_path), script)


def test_a_heartbeat_lost_while_a_start_is_refused_leaves_the_next_run_alone(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        adopting = asyncio.create_task(cell.start(adopt=7))
        await asyncio.sleep(0)
        assert not adopting.done()
        panel.subject.heartbeat_changed(False)
        with pytest.raises(CellError):
            await adopting
        await panel.run_to_the_end()
        assert cell.notes(1, "pause") == []

    on_a_panel(write_config(tmp_path), script)


def test_a_warning_is_a_bit_beside_a_valid_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from procedures.hand_eye import verdict

    genuine = verdict.solve_hand_eye

    def doubtful(path: Path, **options: Any) -> Any:
        return genuine(path, **options).changed(verdict="warn")

    monkeypatch.setattr(verdict, "solve_hand_eye", doubtful)

    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.run_to_the_end()
        assert panel.has(WARNING)
        assert warnings_shown(panel.read("warning_bits")) == ["verdict_warn"]
        assert panel.has(RESULT_VALID)
        await cell.engine.reset(WHO)
        assert panel.has(WARNING), "until it is acknowledged"

    on_a_panel(write_config(tmp_path), script)


def test_a_result_beyond_a_limit_of_the_job_is_done_but_not_valid(tmp_path: Path) -> None:
    async def script(cell: ObjectCell, panel: Panel) -> None:
        await panel.run_to_the_end()
        assert cell.result(1)["verdict"] == "fail"
        assert cell.result(1)["result"] is not None
        assert panel.has(DONE)
        assert not panel.has(RESULT_VALID)
        assert not panel.has(WARNING)

    limits = {"max_error_t_m": 1e-7}
    on_a_panel(write_config(tmp_path, job={"accept": limits}), script)
