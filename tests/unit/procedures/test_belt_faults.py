"""What picking makes of a belt and a camera that do something else than usual, on virtual time."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fakes.object import run_virtual
from procedures.belt.items import Outcome
from tests.kit.object_cell import ObjectCell, no_report, refused
from tests.kit.picking_cell import picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted, truth_of

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

LATE = {"zone": {"min_m": 0.15, "max_m": 0.45}}  # items are picked two seconds after they left the picture
APART = {"spacing_m": "0.4"}  # so that the arm waits for the next one


def inject(cell: ObjectCell, device: str, kind: str, **arguments: Any) -> None:
    cell.plant.plant(device).inject(kind, arguments)


def off_since(cell: ObjectCell, t: float) -> np.ndarray:
    """(n,) m: how far beside the grasp point each contact after ``t`` truly was."""
    truth_of(cell)
    gripper = cell.plant.world.gripper
    assert gripper is not None
    return np.array([np.hypot(*c.off_m) for c in gripper.contacts if c.t > t and c.off_m is not None])


def test_counts_that_wrap_change_nothing(tmp_path: Path) -> None:
    world = {"count_at_start": "64000"}  # the first item is met at about 5000 counts more

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2}, world), lens=False) as cell:
            raw: list[int] = []
            cell.context.device("belt").counts.subscribe(lambda sample: raw.append(sample.value.raw))
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert min(np.diff(raw)) < -60000
            assert counted(cell, run_id) == {**dict.fromkeys(Outcome, 0), "picked": 2}
            assert [w["code"] for w in cell.result(run_id)["warnings"]] == [
                "belt.contact-95",  # by the belt, which is not calibrated
                "belt.nominal",
                "belt.delays",
                "belt.lens",
            ]
            assert np.max(off_since(cell, 0.0)) < 0.5e-3
            assert not cell.notes(run_id, "encoder slip")
            assert not cell.notes(run_id, "encoder jump")

    run_virtual(scene())


def test_a_position_that_somebody_sets_is_told_and_no_item_is_met_by_it(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2})) as cell:
            run_id = await cell.start()
            await cell.until_state("descend")
            inject(cell, "belt", "wrap", before=30_000)  # by a jump
            struck = cell.clock.now()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            (note,) = cell.notes(run_id, "encoder jump")
            assert abs(note["by_m"]) > 0.01
            assert counted(cell, run_id)["lost"] >= 1
            assert np.max(off_since(cell, struck)) < 0.5e-3
            assert "belt.jump" in {w["code"] for w in cell.result(run_id)["warnings"]}

    run_virtual(scene())


def test_a_position_that_is_set_to_zero_begins_anew_and_is_no_jump(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 1})) as cell:
            run_id = await cell.start()
            await cell.until_state("descend")
            encoder = cell.plant.encoder.encoder
            encoder.preset(cell.clock.now(), 0)
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert len(cell.notes(run_id, "counts begin anew")) == 1
            assert not cell.notes(run_id, "encoder jump")
            assert counted(cell, run_id)["lost"] >= 1
            assert "belt.jump" not in {w["code"] for w in cell.result(run_id)["warnings"]}

    run_virtual(scene())


@pytest.mark.parametrize("m", [0.005, -0.005])
def test_a_slip_is_told_by_its_size_and_items_out_of_sight_are_met_all_the_same(
    tmp_path: Path, m: float
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 3, **LATE}, APART)) as cell:
            run_id = await cell.start()
            await cell.until(lambda: counted(cell, run_id)["picked"], "a pick")
            await cell.until_state("wait")
            inject(cell, "belt", "slip", m=m)
            slipped = cell.clock.now()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "warn")
            (note,) = cell.notes(run_id, "encoder slip")
            assert note["ahead_m"] == pytest.approx(m, abs=5 * note["sigma_m"] + 1e-4)
            assert note["items"] >= 2
            off = off_since(cell, slipped + 0.3)
            assert len(off) == 2
            assert np.max(off) < 1e-3
            codes = {w["code"] for w in cell.result(run_id)["warnings"]}
            assert "belt.slip" in codes
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_a_belt_that_stands_for_ten_seconds_is_waited_for_at_rest_and_picked_from_again(
    tmp_path: Path,
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 1})) as cell:
            run_id = await cell.start()
            await cell.until_state("approach")
            inject(cell, "belt", "belt-stop", for_s=10.0)
            stopped = cell.clock.now()
            await cell.until(lambda: cell.engine.packml.name == "SUSPENDED", "suspended", 8.0)
            assert cell.engine.status()["state"] == "standing"
            assert cell.at_rest()
            while cell.clock.now() < stopped + 9.9:
                assert cell.engine.packml.name == "SUSPENDED"
                assert cell.at_rest()
                await cell.clock.sleep(0.5)
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert counted(cell, run_id)["picked"] == 1
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_a_camera_that_stalls_brings_no_items_but_those_known_are_picked_and_the_result_warns(
    tmp_path: Path,
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2})) as cell:
            run_id = await cell.start()
            await cell.until_state("approach")
            inject(cell, "camera", "silence", duration_s=0.9)
            await cell.clock.sleep(0.7)
            (begun,) = cell.notes(run_id, "camera stall")
            seen = len(cell.notes(run_id, "item"))
            await cell.until(lambda: cell.notes(run_id, "camera back"), "pictures again", 3.0)
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "warn")
            assert begun["waited_s"] > 0.5
            assert len(cell.notes(run_id, "item")) > seen
            assert counted(cell, run_id)["picked"] == 2
            assert "belt.camera-stall" in {w["code"] for w in cell.result(run_id)["warnings"]}
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_pictures_that_come_too_late_are_not_used_and_the_result_says_how_many(tmp_path: Path) -> None:
    world = {"exposure_s": "0.1\nlatency_s = 1.0"}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, world=world)) as cell:
            run_id = await cell.start()
            await cell.clock.sleep(3.0)
            await cell.engine.finish("test")
            await cell.finished(run_id)
            result = cell.result(run_id)
            (warning,) = [w for w in result["warnings"] if w["code"] == "belt.late-pictures"]
            assert 10 <= int(warning["text"].split()[0]) <= 80
            assert result["result"]["seen"] == 0

    run_virtual(scene())


@pytest.mark.parametrize(
    ("device", "kind"), [("camera", "freeze"), ("belt", "stuck"), ("belt", "freeze")]
)  # the picture stands; the wheel stands; the encoder repeats itself
def test_pictures_and_counts_that_do_not_move_alike_end_the_job_by_name_at_rest(
    tmp_path: Path, device: str, kind: str
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until(lambda: counted(cell, run_id)["picked"], "a pick")
            inject(cell, device, kind)
            begun = cell.clock.now()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "BELT_ASTRAY")
            assert cell.clock.now() - begun < 3.0
            assert cell.at_rest()
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_nothing_goes_on_after_a_protective_stop_in_mid_follow(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("grip")
            inject(cell, "arm", "protective-stop")
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "ARM_PROTECTIVE_STOP")
            await cell.clock.sleep(0.5)
            where = cell.plant.world.track.at(cell.clock.now())[0]
            agrees_with_the_world(cell, run_id)
            cell.plant.plant("arm").clear()
            await cell.until(cell.all_ready, "all devices back", 30.0)
            await cell.clock.sleep(5.0)
            assert np.array_equal(where, cell.plant.world.track.at(cell.clock.now())[0])
            assert (await refused(cell.start())).name == "MOTION_LATCHED"

    run_virtual(scene())


def test_more_items_than_the_queue_takes_are_let_pass_and_counted_by_name(tmp_path: Path) -> None:
    async def scene() -> None:
        config = picking_config(tmp_path, {"picks": 4, "queue_limit": 3}, {"spacing_m": "0.12"})
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            longest = 0

            def look() -> None:
                nonlocal longest
                longest = max(longest, int(cell.engine.status()["live"].get("queue_length", 0)))

            cell.engine.subscribe(look)
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert 0 < longest <= 3
            outcomes = counted(cell, run_id)
            assert outcomes["picked"] == 4
            assert outcomes["queue full"] >= 5
            agrees_with_the_world(cell, run_id)
            causes = {w["code"] for w in cell.result(run_id)["warnings"]}
            assert "belt.queue-full" in causes

    run_virtual(scene())


@pytest.mark.parametrize("job", ["belt-tracking", "belt-calibration"])
def test_an_emergency_of_the_encoder_is_noted_once_and_the_result_warns(tmp_path: Path, job: str) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 1})) as cell:
            run_id = await cell.start(job=job)
            await cell.clock.sleep(1.0)
            inject(cell, "belt", "alarm", code=0x5017)
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "warn")
            assert [note["what"] for note in cell.notes(run_id, "encoder emergency")] == ["emergency 5017h"]
            (warning,) = [w for w in cell.result(run_id)["warnings"] if w["code"] == "belt.encoder-emergency"]
            assert "5017h" in warning["text"]

    run_virtual(scene())
