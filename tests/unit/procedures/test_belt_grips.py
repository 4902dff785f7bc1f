"""What picking makes of items and grips that are not as they should be, on virtual time."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fakes.object import run_virtual
from fakes.world.belt.gripper import Gripper
from fakes.world.belt.items import Items
from procedures.belt.items import Outcome
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted, truth_of

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

LATE = {"zone": {"min_m": 0.15, "max_m": 0.45}}  # items are picked two seconds after they left the picture
NONE = dict.fromkeys(Outcome, 0)


def gripper_of(cell: ObjectCell) -> Gripper:
    gripper = cell.plant.world.gripper
    assert gripper is not None
    return gripper


def push(items: Items, number: int, across_m: float) -> None:
    """Somebody knocks against an item that no camera sees any more."""
    lying = items.lying(number)
    items._lying[number] = replace(lying, across=lying.across + across_m)


def lives(cell: ObjectCell, run_id: int, outcome: Outcome) -> list[list[str]]:
    """What happened to each item that ended so."""
    rows = [row for row in cell.ledger.items(run_id) if row["outcome"] == outcome]
    return [[what for _, what in row["detail"]["history"]] for row in rows]


def test_fingers_that_refuse_are_counted_and_each_item_is_tried_twice(tmp_path: Path) -> None:
    async def scene() -> None:
        config = picking_config(tmp_path, {"picks": 2}, {"confirm": "7\nwithin_m = 1e-9"})
        async with picking_cell(config) as cell:
            run_id, gripper = await cell.start(), gripper_of(cell)
            await cell.until(lambda: counted(cell, run_id)["grip failed"] == 2, "two failed grips", 60.0)
            assert not truth_of(cell).taken
            gripper.truth = gripper.truth.model_copy(update={"within_m": 0.003})
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "warn")
            outcomes = counted(cell, run_id)
            assert (outcomes["grip failed"], outcomes["picked"]) == (2, 2)
            life = ["seen", "approach", "contact", "not held", "grip failed", "grip failed"]
            assert lives(cell, run_id, Outcome.GRIP_FAILED) == [life, life]
            closings = Counter(contact.item for contact in gripper.contacts)
            assert sorted(closings.values()) == [1, 1, 2, 2]
            assert cell.result(run_id)["result"]["success"] == 0.5
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_grip_after_grip_that_takes_nothing_ends_the_job_and_says_what_is_known_of_them(
    tmp_path: Path,
) -> None:
    async def scene() -> None:
        config = picking_config(tmp_path, {"failed_grips": 2}, {"confirm": "7\nwithin_m = 1e-9"})
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "GRIPS_FAILED")
            assert len(lives(cell, run_id, Outcome.GRIP_FAILED)) == 2
            off, following, lag = map(float, re.findall(r"([0-9.]+) (?:mm|ms)", end["error"]["text"]))
            assert off == pytest.approx(1e3 * np.linalg.norm(contact_errors(cell), axis=1).max(), abs=0.3)
            assert following < 0.5
            assert 0.0 <= lag < 100.0
            assert "has not confirmed an item yet" in end["error"]["text"]

    run_virtual(scene())


def test_an_alarm_of_grips_that_is_held_counts_from_zero_once_somebody_has_looked(tmp_path: Path) -> None:
    async def scene() -> None:
        job = {"failed_grips": 2, "on_failed_grips": "hold", "picks": 1}
        config = picking_config(tmp_path, job, {"confirm": "7\nwithin_m = 1e-9"})
        async with picking_cell(config) as cell:
            run_id, gripper = await cell.start(), gripper_of(cell)
            await cell.until(lambda: cell.engine.status()["prompt"], "a prompt", 60.0)
            await cell.clock.sleep(3.0)
            assert cell.at_rest()
            assert counted(cell, run_id)["grip failed"] == 2, "nothing is picked meanwhile"
            await cell.answer()
            await cell.until(lambda: counted(cell, run_id)["grip failed"] == 3, "one more", 60.0)
            gripper.truth = gripper.truth.model_copy(update={"within_m": 0.003})
            end = await cell.finished(run_id)
            assert (end["outcome"], counted(cell, run_id)["picked"]) == ("complete", 1)

    run_virtual(scene())


def test_an_item_that_the_first_closing_missed_is_taken_by_the_second(tmp_path: Path) -> None:
    async def scene() -> None:
        config = picking_config(tmp_path, {"picks": 1}, {"confirm": "7\nwithin_m = 1e-9"})
        async with picking_cell(config) as cell:
            run_id, gripper = await cell.start(), gripper_of(cell)
            await cell.until(lambda: gripper.contacts, "the first closing", 60.0)
            gripper.truth = gripper.truth.model_copy(update={"within_m": 0.003})
            assert (await cell.finished(run_id))["outcome"] == "complete"
            life = ["seen", "approach", "contact", "not held", "gripped", "picked"]
            assert lives(cell, run_id, Outcome.PICKED) == [life]
            assert [contact.taken for contact in gripper.contacts] == [False, True]
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


@pytest.mark.parametrize(("across_m", "outcome"), [(0.02, "grip failed"), (0.0015, "picked")])
def test_an_item_that_was_moved_out_of_sight_counts_as_picked_only_when_the_fingers_have_it(
    tmp_path: Path, across_m: float, outcome: str
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2, **LATE})) as cell:
            run_id, items = await cell.start(), cell.plant.world.items
            assert items is not None
            await cell.until_state("approach", 30.0)
            first = items.numbers(cell.clock.now(), 0.6, 1.2)[0]  # below the arm, and out of the picture
            push(items, first, across_m)
            assert (await cell.finished(run_id))["outcome"] == "complete"
            truth = truth_of(cell)
            assert gripper_of(cell).contacts[0].item == first
            assert (first in truth.taken) is (outcome == "picked")
            assert np.linalg.norm(contact_errors(cell)[0]) == pytest.approx(across_m, abs=1e-3)
            outcomes = counted(cell, run_id)
            assert (outcomes["picked"], outcomes["lost"]) == (2, 0)
            assert outcomes["grip failed"] == (outcome == "grip failed")
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


@pytest.mark.parametrize("state", ["lift", "place"])
def test_an_item_that_falls_out_on_the_way_is_lost_by_name_and_the_job_goes_on(
    tmp_path: Path, state: str
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2})) as cell:
            run_id = await cell.start()
            await cell.until_state(state, 30.0)
            assert gripper_of(cell).empty(cell.clock.now()) is not None
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "warn")
            outcomes = counted(cell, run_id)
            assert (outcomes["lost"], outcomes["picked"]) == (1, 2)
            assert lives(cell, run_id, Outcome.LOST) == [["seen", "approach", "contact", "gripped", "lost"]]
            assert len(truth_of(cell).taken) == 3, "it left the belt, and was not put down"
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_an_encoder_that_counts_down_while_the_belt_goes_on_is_as_good(tmp_path: Path) -> None:
    job = {"picks": 3}
    nominal = "{ m_per_count = -0.0001, dir = [0.9998, -0.02, 0.0] }"
    world = {
        "m_per_count": "-0.0001",
        "belt_nominal": nominal,
        "count_at_start": "4000",
    }  # and wraps on the way

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, world)) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert cell.plant.world.belt is not None
            assert cell.plant.world.belt.travel_at(cell.clock.now()) > 0.4
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert len(off) == 3
            assert off.max() < 0.5e-3
            assert counted(cell, run_id) == {**NONE, "picked": 3}
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_items_of_many_heights_are_each_met_at_their_own(tmp_path: Path) -> None:
    job = {"picks": 3, "items": {"max_height_m": 0.09}, "above_m": 0.1}
    world = {"size_m": "[0.06, 0.04, 0.03]\nheight_m = [0.015, 0.09]"}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, world)) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert np.linalg.norm(contact_errors(cell), axis=1).max() < 0.5e-3
            taken, items = [c for c in gripper_of(cell).contacts if c.taken], cell.plant.world.items
            assert items is not None
            heights = [items.lying(c.item).size_m[2] for c in taken if c.item is not None]
            assert np.ptp(heights) > 0.02
            assert max(c.distance_m for c in taken if c.distance_m is not None) < 1e-3
            assert counted(cell, run_id)["picked"] == len(heights) == 3
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_items_that_lie_closer_than_the_spacing_are_picked_one_by_one(tmp_path: Path) -> None:
    job = {"picks": 3, "items": {"min_size_m": 0.01}}
    world = {
        "size_m": "[0.015, 0.01, 0.03]", "spacing_m": "0.025", "jitter_m": "0.0", "lateral_m": "0.0"
    }  # fmt: skip

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, world)) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert len(off) == 3
            assert off.max() < 0.5e-3
            outcomes = counted(cell, run_id)
            assert outcomes["picked"] == 3
            assert not outcomes["grip failed"]
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())
