"""Picking in a whole cell on virtual time: contacts as they truly were, and what ends or holds the job."""

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.belt import descent
from fakes.object import run_virtual
from procedures.belt.items import Outcome
from tests.kit.object_cell import ObjectCell, no_report, refused
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def picked(cell: ObjectCell, run_id: int) -> list[dict[str, Any]]:
    return [row for row in cell.ledger.items(run_id) if row["outcome"] == Outcome.PICKED]


def test_items_are_met_gripped_and_put_down_and_their_lives_are_kept(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 3})) as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert len(off) == 3
            assert np.sqrt(np.mean(off**2)) < 0.5e-3
            rows = picked(cell, run_id)
            assert len({row["item"] for row in rows}) == 3
            assert [what for _, what in rows[0]["detail"]["history"]] == [
                "seen", "approach", "contact", "gripped", "picked"
            ]  # fmt: skip
            world = cell.plant.world
            assert world.gripper is not None
            taken = [c.item for c in world.gripper.contacts if c.taken]
            assert len(set(taken)) == len(taken) == 3, "nothing is picked twice"
            assert cell.at_rest()

    run_virtual(scene())


@pytest.mark.parametrize("way", ["finish", "abort", "halt"])
def test_each_way_out_ends_the_following_first(tmp_path: Path, way: str) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("grip")
            await getattr(cell.engine, way)("test")
            end = await cell.finished(run_id)
            assert end["outcome"] == {"finish": "complete", "abort": "stopped", "halt": "halted"}[way]
            assert cell.at_rest()
            where = cell.plant.world.track.at(cell.clock.now())[0]
            await cell.clock.sleep(3.0)
            assert np.array_equal(where, cell.plant.world.track.at(cell.clock.now())[0])

    run_virtual(scene())


def test_in_a_real_world_the_lag_of_the_arm_and_the_rows_of_the_shutter_are_made_up_for(
    tmp_path: Path,
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 1}, real=True)) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert len(off) == 1
            assert off[0] < 0.5e-3
            found = cell.result(run_id)["result"]
            truth = cell.plant.world.config.gripper
            assert truth is not None
            assert found["gripper_closing_s"] == pytest.approx(truth.close_s, abs=0.02)
            assert found["arm_lag_s"] > 0.04
            frames = cell.context.supervisor.ready("camera").frames
            assert frames.last().value.row_time_s > 0.0

    run_virtual(scene())


def test_a_pause_is_taken_at_rest_above_the_belt_and_the_job_goes_on(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 1})) as cell:
            run_id = await cell.start()
            await cell.until_state("approach")
            await cell.engine.pause("test")
            await cell.until(lambda: cell.engine.packml.name == "HELD", "held", 30.0)
            assert cell.at_rest()
            await cell.clock.sleep(2.0)
            await cell.engine.resume("test")
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert len(picked(cell, run_id)) == 1

    run_virtual(scene())


@pytest.mark.parametrize("speed_m_s", [0.0, -0.1])
def test_a_belt_that_stands_or_runs_backward_suspends_the_job_at_rest(
    tmp_path: Path, speed_m_s: float
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2})) as cell:
            run_id = await cell.start()
            await cell.until(lambda: picked(cell, run_id), "a pick", 60.0)
            belt = cell.plant.world.belt
            assert belt is not None
            belt.run(cell.clock.now(), speed_m_s)
            await cell.until(lambda: cell.engine.packml.name == "SUSPENDED", "suspended", 30.0)
            await cell.clock.sleep(3.0)
            assert cell.engine.packml.name == "SUSPENDED"
            assert cell.at_rest()
            belt.resume(cell.clock.now())
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert len(picked(cell, run_id)) == 2

    run_virtual(scene())


@pytest.mark.parametrize(
    ("device", "kind", "name"),
    [
        ("arm", "protective-stop", "ARM_PROTECTIVE_STOP"),
        ("belt", "unplug", "DEVICE_LOST"),
        ("camera", "silence", "DEVICE_LOST"),
    ],
)
def test_a_fault_in_mid_follow_ends_the_job_by_name_at_rest(
    tmp_path: Path, device: str, kind: str, name: str
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("descend")
            cell.plant.plant(device).inject(kind)
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", name)
            assert cell.at_rest()
            await asyncio.sleep(0)

    run_virtual(scene())


def test_an_uncalibrated_camera_is_refused_before_anything_moves(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            await cell.engine.decisions.rollback("T_base_camera", "test")
            assert (await refused(cell.start())).name == "BELT_NO_CAMERA"

    run_virtual(scene())


def test_a_gripper_that_holds_something_is_not_opened(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            gripper = cell.plant.world.gripper
            assert gripper is not None
            gripper._held.append((cell.clock.now(), 99))
            await cell.clock.sleep(1.0)
            end = await cell.run_job()
            assert end["error"]["name"] == "GRIPPER_HOLDS"
            assert gripper.holds(cell.clock.now()) == 99

    run_virtual(scene())


def test_an_encoder_that_restarts_loses_the_items_on_their_way_and_the_job_goes_on(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2})) as cell:
            run_id = await cell.start()
            await cell.until_state("approach")
            cell.plant.plant("belt").inject("reboot", {"boot_s": 0.1})
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            lost = [row for row in cell.ledger.items(run_id) if row["outcome"] == Outcome.LOST]
            assert lost, "what was on its way is lost by name"
            assert len(picked(cell, run_id)) == 2
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert np.max(off) < 1e-3, "nothing is gripped where it was before the restart"

    run_virtual(scene())


def test_counts_of_a_whole_millimetre_are_fine_enough_to_come_down_on_an_item(tmp_path: Path) -> None:
    job = {"picks": 2}
    world = {
        "belt_nominal": "{ m_per_count = 0.001, dir = [0.9998, -0.02, 0.0] }",
        "m_per_count": "0.001",
        "profile": "[{ speed_m_s = 0.2 }]\nripple = [{ amplitude = 0.03, hz = 1 }]",
    }

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, world)) as cell:
            end = await cell.finished(await cell.start())
            assert end["outcome"] == "complete"
            assert np.linalg.norm(contact_errors(cell), axis=1).max() < 1e-3

    run_virtual(scene())


def test_a_tool_that_never_gets_over_its_item_lets_it_go_at_the_end_of_the_zone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(descent, "BESIDE_M", -1.0)

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("descend")
            await cell.until(lambda: bool(cell.ledger.items(run_id)), "the end of an item", 30.0)
            (first,) = cell.ledger.items(run_id)
            assert first["outcome"] == Outcome.OUT_OF_ZONE.value
            assert cell.plant.world.gripper is not None
            assert not cell.plant.world.gripper.contacts
            await cell.engine.finish("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(scene())
