"""Parts into slots and out of them on virtual time, judged against the twin's truth."""

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.poses import from_pose6
from daemon.config import CellConfig
from fakes.object import run_virtual
from procedures.documents import read_result
from procedures.slot.data import read_data_set
from procedures.slot.procedure import SlotInsertion
from procedures.slot.truth import judge_slot
from procedures.slot.words import slot_lines
from procedures.words import mm
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell
from tests.kit.slot_cell import (
    HAND_EYE_COV,
    SLOT,
    beside,
    config,
    give_hand_eye,
    lens_of,
    rack_of,
    scenario_with,
)

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

NEW_PART, OLD_PART = 0, 1  # at the feed, and in slot 2
TOLERANCE_M = 0.003  # insertion.tolerance_m: of the travel, by what is known of the slot's depth


class Ran:
    """One run, and the cell after it."""

    def __init__(self, cell: ObjectCell, run: int, end: Mapping[str, Any]) -> None:
        self.cell, self.run, self.end = cell, run, end
        self.error = (end.get("error") or {}).get("name")
        self.states = [
            line["state"] for line in cell.journal(run) if line["kind"] == "state" and "state" in line
        ]
        self.result = None if self.error else cell.result(run)

    @property
    def answer(self) -> dict[str, Any]:
        assert self.result is not None
        return dict(self.result["result"])

    @property
    def held(self) -> int | None:
        gripper = self.cell.plant.world.gripper
        assert gripper is not None
        return gripper.holds(self.cell.clock.now())

    def in_slot(self, number: int) -> int | None:
        return rack_of(self.cell).in_slot(number, self.cell.clock.now())


def run_of(
    setting: CellConfig,
    look: Callable[[Ran], None],
    prepare: Callable[[ObjectCell], None] = give_hand_eye,
) -> None:
    """One run of the job; ``look`` at what came of it while the cell is still there."""

    async def scene() -> None:
        async with open_cell(setting, job=SLOT) as cell:
            prepare(cell)
            number = await cell.start()
            end = await cell.finished(number)
            assert cell.at_rest()
            look(Ran(cell, number, end))

    run_virtual(scene())


def test_a_part_is_fetched_measured_and_inserted_by_the_lens_that_belongs_to_the_hand_eye(
    tmp_path: Path,
) -> None:
    told = "[world.camera.told]\nfocal = 0.003\ncentre_px = [4.0, -3.0]"
    shipped = "[world.camera.told]\nfocal = 0.0027\ncentre_px = [-0.8, 0.0]"
    scenario = scenario_with(tmp_path, shipped, told)

    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.result["verdict"] == "pass"
        assert ran.states == [
            "prepare", "fetch", "look", "measure", "align", "insert", "release", "retreat", "solve",
        ]  # fmt: skip
        assert ran.answer["states"] == ["none", "gripped", "inserted", "released"]
        assert ran.answer["travel_m"] == pytest.approx(0.06, abs=TOLERANCE_M)
        assert (ran.in_slot(1), ran.held) == (NEW_PART, None)
        assert rack_of(ran.cell).on_face == []
        budget = ran.answer["budget"]
        assert beside(ran.cell, NEW_PART, 1) < budget["predicted_95_m"] < budget["clearance_m"]
        assert [row["source"] for row in budget["by_source"]][-1] == "arm repeatability"
        assert len(budget["by_source"]) == 7
        found = read_result(ran.result)
        assert found.figures().predicted_95_m == budget["predicted_95_m"]
        assert any("part in the gripper" in line for line in slot_lines(found))  # type: ignore[arg-type]
        truth = ran.cell.plant.world.truth(ran.cell.clock.now())
        judged = judge_slot(found, truth, tmp_path)  # type: ignore[arg-type]
        assert judged.inside95
        predicted = mm(budget["predicted_95_m"])
        assert judged.stated == f"part less than {predicted} beside the middle of slot 1 (95 %)"
        assert judged.off.endswith(" mm beside it")
        data, _ = read_data_set(ran.cell.folder(ran.run).path)
        assert data.look is not None
        assert data.look.looks == 2
        world = ran.cell.plant.world
        assert data.look.camera.model_dump(exclude={"sigma"}) == lens_of(world.told_intrinsics)
        assert data.look.lens is not None
        assert data.look.lens.model_dump(exclude={"sigma"}) == lens_of(world.intrinsics)
        again = SlotInsertion.solve_again(ran.cell.folder(ran.run).path / "slot.json", {}, {})
        assert again.as_json()["result"] == ran.answer

    run_of(config(tmp_path, scenario=scenario), look)


def test_without_errors_of_arm_and_lens_the_travel_of_a_part_is_that_of_the_slot(tmp_path: Path) -> None:
    def look(ran: Ran) -> None:
        assert ran.answer["travel_m"] == pytest.approx(0.06, abs=0.0005)

    run_of(config(tmp_path, scenario="slot:ideal"), look)


@pytest.mark.parametrize("away_m", [0.0, 0.2])
def test_a_gripper_that_nothing_confirms_may_have_moved_no_part(tmp_path: Path, away_m: float) -> None:
    part = "T_base_part = [-0.6, 0.15, 0.1"
    scenario = scenario_with(tmp_path, part, part.replace("0.15", f"{0.15 + away_m}"))
    setting = config(tmp_path, scenario=scenario, gripper_keys={"counts_after_s": 0.5})

    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.result["verdict"] == ("warn" if away_m == 0.0 else "fail")
        assert [row["code"] for row in ran.result["warnings"]] == ["slot.unconfirmed"]
        assert (ran.in_slot(1) is None) == (away_m > 0.0)

    run_of(setting, look)


def test_a_part_is_replaced_by_another(tmp_path: Path) -> None:
    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.result["verdict"] == "pass"
        assert (ran.in_slot(2), ran.held) == (NEW_PART, None)
        put = rack_of(ran.cell).T_base_part(OLD_PART, ran.cell.clock.now())
        assert put.translation == pytest.approx([-0.6, 0.25, 0.1], abs=0.003)
        assert ran.answer["states"] == ["none", "gripped", "released", "gripped", "inserted", "released"]

    run_of(config(tmp_path, action="replace", slot=2), look)


def test_what_is_in_the_way_jams_the_part_which_is_drawn_back_and_held(tmp_path: Path) -> None:
    scenario = scenario_with(tmp_path, "grasp_m = 0.08\n", "grasp_m = 0.08\nblocked = { 1 = 0.025 }\n")

    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.result["verdict"] == "fail"
        assert ran.result["reasons"][0].startswith("jammed: ")
        assert ran.answer["part"] == "jammed"
        assert ran.answer["travel_m"] == pytest.approx(0.025, abs=0.002)
        assert ran.held == NEW_PART
        front = rack_of(ran.cell).offset(NEW_PART, 1, ran.cell.clock.now()).translation
        assert front[2] < -0.004
        assert "release" not in ran.states

    run_of(config(tmp_path, scenario=scenario), look)


@pytest.mark.soak
def test_a_part_that_meets_the_plate_is_stopped_before_it_travels(tmp_path: Path) -> None:
    """The camera is 1 mm from where its calibration has it, and nothing tells the job."""

    def look(ran: Ran) -> None:
        assert ran.answer["part"] == "jammed"
        assert ran.answer["travel_m"] < 0.003
        assert rack_of(ran.cell).on_face
        assert ran.held == NEW_PART

    run_of(config(tmp_path), look, lambda cell: give_hand_eye(cell, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0]))


def test_an_insertion_is_refused_when_its_error_may_exceed_the_clearance(tmp_path: Path) -> None:
    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.result["verdict"] == "fail"
        assert ran.result["reasons"][0].startswith("clearance: ")
        assert "hand-eye" in ran.result["reasons"][0]
        assert ran.states[-2:] == ["measure", "solve"]
        assert (ran.answer["part"], ran.held) == ("gripped", NEW_PART)

    run_of(config(tmp_path), look, lambda cell: give_hand_eye(cell, cov=25.0 * HAND_EYE_COV))


@pytest.mark.soak
def test_a_part_that_is_lost_on_the_way_ends_the_job(tmp_path: Path) -> None:
    def prepare(cell: ObjectCell) -> None:
        give_hand_eye(cell)
        gripper = cell.plant.world.gripper
        assert gripper is not None
        cell.at_state("align", lambda: gripper.empty(cell.clock.now()) and None)

    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.answer["part"] == "lost"
        assert ran.result["reasons"][0].startswith("lost: ")
        assert "insert" not in ran.states

    run_of(config(tmp_path), look, prepare)


def test_a_run_that_is_finished_before_the_look_says_so(tmp_path: Path) -> None:
    def prepare(cell: ObjectCell) -> None:
        give_hand_eye(cell)
        tasks: set[asyncio.Task[None]] = set()
        cell.at_state("fetch", lambda: tasks.add(asyncio.ensure_future(cell.engine.finish(WHO))))

    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.result["verdict"] == "fail"
        assert ran.result["result"] is None
        assert ran.result["reasons"][0].startswith("finished: ")
        assert ran.states[-1] == "solve"

    run_of(config(tmp_path), look, prepare)


@pytest.mark.parametrize(
    ("job", "code"),
    [
        ({"slot": 2}, "SLOT_OCCUPIED"),
        ({"action": "pull"}, "SLOT_EMPTY"),
        ({"opening": {"width_m": 0.055, "height_m": 0.021, "depth_m": 0.06}}, "OPENING_NOT_SEEN"),
        ({"fetch_pose": None}, "PART_NOT_HELD"),
    ],
)
def test_what_keeps_a_part_from_being_tried_is_an_error(
    tmp_path: Path, job: dict[str, Any], code: str
) -> None:
    def look(ran: Ran) -> None:
        assert ran.error == code
        assert "insert" not in ran.states

    run_of(config(tmp_path, **job), look)


def test_a_board_that_an_earlier_job_looked_for_is_looked_for_no_more(tmp_path: Path) -> None:
    async def scene() -> None:
        async with open_cell(config(tmp_path), job=SLOT) as cell:
            give_hand_eye(cell)
            camera: Any = cell.context.device("flange_camera")
            await camera.set_target(cell.plant.world.target)
            # The camera of this face gives no picture while a board is looked for.
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(scene())


def test_a_camera_of_unknown_uncertainty_is_refused(tmp_path: Path) -> None:
    async def scene() -> None:
        async with open_cell(config(tmp_path), job=SLOT) as cell:
            with pytest.raises(Exception, match="how good the camera's pose is"):
                await cell.start()

    run_virtual(scene())


def test_a_dry_run_lists_every_station_and_moves_nothing(tmp_path: Path) -> None:
    async def scene() -> None:
        async with open_cell(config(tmp_path), job=SLOT) as cell:
            give_hand_eye(cell)
            before = cell.plant.world.track.at(cell.clock.now())[0]
            plan = (await cell.dry_run())["plan"]
            assert [pose["pose"] for pose in plan["poses"]] == [
                "look",
                "before",
                "seated",
                "fetch",
                "put_down",
            ]
            seated = from_pose6(plan["poses"][2]["T_base_flange"]).translation
            assert seated[2] == pytest.approx(0.15 - 0.06 + 0.26, abs=1e-4)
            assert np.array_equal(before, cell.plant.world.track.at(cell.clock.now())[0])

    run_virtual(scene())


@pytest.mark.soak
@pytest.mark.parametrize("state", ["fetch", "look", "measure", "align", "insert"])
def test_after_a_stop_in_any_state_the_next_run_goes_on_with_the_part(tmp_path: Path, state: str) -> None:
    """An arm that was left in the slot comes out along it first."""

    async def scene() -> None:
        async with open_cell(config(tmp_path), job=SLOT) as cell:
            give_hand_eye(cell)
            arm = cell.plant.controller
            cell.at_state(state, lambda: arm.inject("protective-stop"), after_s=0.6)
            first = await cell.start()
            stopped = Ran(cell, first, await cell.finished(first))
            assert stopped.error == "ARM_PROTECTIVE_STOP"
            assert cell.at_rest()
            assert stopped.held == (None if state == "fetch" else NEW_PART)
            arm.clear()
            await cell.until(cell.all_ready, "ready devices")
            await cell.engine.reset(WHO)
            second = await cell.start()
            ran = Ran(cell, second, await cell.finished(second))
            assert ("retreat" in ran.states[:2]) is (state == "insert")
            assert ran.answer["part"] == "released"
            assert ran.in_slot(1) == NEW_PART
            assert rack_of(cell).on_face == []

    run_virtual(scene())


@pytest.mark.soak
@pytest.mark.parametrize(
    ("state", "after_s", "step"), [("insert", 0.5, "insertion"), ("release", 0.0, "let go of the part")]
)
def test_a_step_of_an_insertion_that_a_silence_interrupts_begins_anew(
    tmp_path: Path, state: str, after_s: float, step: str
) -> None:
    def prepare(cell: ObjectCell) -> None:
        give_hand_eye(cell)
        quiet = {"duration_s": 0.4}
        cell.at_state(state, lambda: cell.plant.controller.inject("silence", quiet), after_s)

    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert ran.result["verdict"] == "pass"
        assert [again["step"] for again in ran.result["inputs"]["steps_taken_again"]] == [step]
        assert ran.in_slot(1) == NEW_PART

    run_of(config(tmp_path), look, prepare)


def test_a_pull_that_a_silence_interrupts_counts_its_force_from_the_beginning(tmp_path: Path) -> None:
    """A part on a spring of 2500 N/m, which a guarded move that began anew would take for nothing."""
    felt = [0.0]

    def prepare(cell: ObjectCell) -> None:
        give_hand_eye(cell)
        rack = rack_of(cell)
        seated = rack.T_base_part(OLD_PART, 0.0).translation

        def sprung(t: float) -> tuple[np.ndarray, np.ndarray]:
            at = rack.T_base_part(OLD_PART, t).translation
            force = 2500.0 * (seated - at)
            if felt[0] < 15.0 <= np.linalg.norm(force):
                asyncio.get_running_loop().call_soon(
                    cell.plant.controller.inject, "silence", {"duration_s": 0.4}
                )
            felt[0] = max(felt[0], float(np.linalg.norm(force)))
            return force, at

        rack.force = sprung  # type: ignore[method-assign]

    def look(ran: Ran) -> None:
        assert ran.result is not None
        assert [again["step"] for again in ran.result["inputs"]["steps_taken_again"]] == ["pull the part"]
        assert ran.answer["states"][-2:] == ["jammed", "released"]
        assert felt[0] < 35.0, "max_force_n is 30, and the arm takes a moment to stop"
        assert ran.answer["force_n"] == pytest.approx(felt[0], abs=4.0)

    run_of(config(tmp_path, action="pull", slot=2), look, prepare)


@pytest.mark.soak
def test_a_part_that_is_gripped_in_a_silence_is_moved_under_the_force_guard_alone(tmp_path: Path) -> None:
    def prepare(cell: ObjectCell) -> None:
        give_hand_eye(cell)
        gripper = cell.plant.world.gripper
        assert gripper is not None
        command = gripper.command

        def in_silence(t: float, close: bool) -> None:
            """The fingers close while nothing is heard of them."""
            gripper.command = command  # type: ignore[method-assign]
            command(t, close)
            cell.plant.controller.inject("silence", {"duration_s": 0.4})

        gripper.command = in_silence  # type: ignore[method-assign]

    def look(ran: Ran) -> None:
        assert ran.answer["states"] == ["none", "gripped", "released"]
        journal = ran.cell.journal(ran.run)
        (again,) = (i for i, line in enumerate(journal) if line.get("event") == "step taken again")
        moves = [line["event"] for line in journal[again:] if line["kind"] == "motion"]
        assert moves[0] == "guarded_move"

    run_of(config(tmp_path, action="pull", slot=2), look, prepare)
