"""An item is put down on a place that an input says to be clear, and nowhere else."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.kinematics import robot_from_spec
from cell.poses import from_pose6
from daemon.config import CellConfig
from daemon.predictions import setup_of
from fakes.object import run_virtual
from fakes.world.belt.gripper import Gripper
from fakes.world.belt.item_truth import PlaceTruth
from fakes.world.belt.place import Place
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.expectation import belt_expectation
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import JOB, picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted, told

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

OFF = "the place is not clear: 'clear' is off"


def config_of(folder: Path, carried_off_s: float, **job: Any) -> CellConfig:
    job = {"place_look_above_m": 0.0, **job}
    world = {"confirm": f"7\n[world.place]\ncarried_off_s = {carried_off_s}"}
    return picking_config(folder, {"place_clear": "clear", **job}, world)


def under_a_beam(folder: Path, height_m: float, **job: Any) -> CellConfig:
    """With a light barrier so far above the place, which the tool breaks as well."""
    config = config_of(folder, 1.0, picks=1, max_duration_s=90.0, **job)
    values = setup_of(config).values
    tool = robot_from_spec(values.robot).forward(np.array(config.poses["place"]))
    x, y, z = (tool * from_pose6(values.tool["T_flange_tool"])).translation
    beam = [float(x), float(y), float(z) + height_m]
    scenario = folder / "scenario.toml"
    carried = "carried_off_s = 1.0"
    scenario.write_text(scenario.read_text("utf-8").replace(carried, f"{carried}\nbeam = {beam}"), "utf-8")
    return config


def place_of(cell: ObjectCell) -> Place:
    place = cell.plant.world.place
    assert place is not None
    return place


def gripper_of(cell: ObjectCell) -> Gripper:
    gripper = cell.plant.world.gripper
    assert gripper is not None
    gripper.settle(cell.clock.now())
    return gripper


def above_place(cell: ObjectCell) -> np.ndarray:
    """(3,) m: the tool's point from the place, in the base."""
    q, world = np.array(cell.config.poses["place"]), cell.plant.world
    place = (world.true.forward(q) * world.T_flange_tool).translation
    return np.asarray(world.tool_point(cell.clock.now()) - place)


async def goes_down_to(cell: ObjectCell, above_m: float) -> None:
    """Wait until the tool is on its way down into the place."""
    while np.hypot(*above_place(cell)[:2]) > 0.004 or above_place(cell)[2] > above_m:
        await cell.clock.sleep(0.004)


async def waits(cell: ObjectCell) -> None:
    await cell.until_state("wait-place", 60.0)
    await cell.until(lambda: cell.engine.packml.name == "SUSPENDED", "suspended", 5.0)
    await cell.clock.sleep(1.0)
    assert cell.at_rest()
    assert gripper_of(cell).holds(cell.clock.now()) is not None
    assert above_place(cell) == pytest.approx(np.array([0.0, 0.0, 0.05]), abs=1e-3)


class _EmptyHanded:
    """A gripper that has put nothing down."""

    put_down: tuple[Any, ...] = ()

    def settle(self, t: float) -> None: ...


def levels_of(times: np.ndarray, **truth: Any) -> list[bool]:
    """Of a place with a thing on it from 10 to 12 s, and another from 15 to 15.05 s."""
    subject = Place(PlaceTruth(carried_off_s=2.0, **truth), _EmptyHanded(), lambda t: np.zeros(3), 9.0)  # type: ignore[arg-type]
    short = Place(PlaceTruth(carried_off_s=0.05, **truth), _EmptyHanded(), lambda t: np.zeros(3), 9.0)  # type: ignore[arg-type]
    subject.block(10.0)
    short.block(15.0)
    return [subject.is_clear(t) and short.is_clear(t) for t in times]


@pytest.mark.parametrize(
    ("truth", "off"),
    [
        ({}, [(10.0, 12.0), (15.0, 15.05)]),
        ({"filter_s": 0.1}, [(10.1, 12.1)]),
        ({"filter_s": 0.04}, [(10.04, 12.04), (15.04, 15.09)]),
        ({"scan_s": 0.3}, [(10.2, 12.0), (15.0, 15.3)]),
        ({"filter_s": 0.1, "scan_s": 0.3}, [(10.2, 12.3)]),
    ],
)
def test_the_level_is_late_by_filter_and_scan_of_its_module(
    truth: dict[str, float], off: list[tuple[float, float]]
) -> None:
    times = np.arange(9.5, 17.0, 0.02) + 0.003
    wanted = [not any(since <= t < until for since, until in off) for t in times]
    assert levels_of(times, **truth) == wanted


def test_a_place_whose_module_filters_for_long_is_put_down_on_no_earlier(tmp_path: Path) -> None:
    async def scene(filter_s: float) -> float:
        config = config_of(tmp_path, 8.0, picks=2)
        scenario = tmp_path / "scenario.toml"
        carried = "carried_off_s = 8.0"
        text = scenario.read_text("utf-8").replace(carried, f"{carried}\nfilter_s = {filter_s}")
        scenario.write_text(text, "utf-8")
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            first, second = (down.t for down in gripper_of(cell).put_down)
            return second - first

    assert run_virtual(scene(0.5)) - run_virtual(scene(0.0)) == pytest.approx(0.5, abs=0.1)


def test_each_item_waits_above_the_place_until_the_one_before_is_carried_off(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 8.0, picks=3)) as cell:
            run_id = await cell.start()
            await waits(cell)
            assert cell.engine.status()["live"]["place_waits"] == 1
            assert (await cell.finished(run_id))["outcome"] == "complete"
            put = [down.t for down in gripper_of(cell).put_down]
            assert len(put) == 3
            assert min(b - a for a, b in pairwise(put)) > 8.0
            assert counted(cell, run_id)["picked"] == 3
            told = cell.result(run_id)["result"]["place_waits"]
            assert told["count"] == 2
            assert 0.0 < told["longest_s"] < told["total_s"] < 16.0
            why = [line["why"] for line in cell.notes(run_id, "suspended")]
            assert why == [f"with an item above the place: {OFF}"] * 2
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


@pytest.mark.parametrize("look_above_m", [None, 0.025])
def test_a_light_barrier_that_the_tool_breaks_does_not_send_it_up_again(
    tmp_path: Path, look_above_m: float | None
) -> None:
    async def scene() -> None:
        config = under_a_beam(tmp_path, 0.02, place_look_above_m=look_above_m)
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert cell.result(run_id)["result"]["place_waits"]["count"] == 0
            assert not cell.notes(run_id, "suspended")
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_a_sensor_that_sees_the_tool_too_high_makes_each_descent_a_counted_wait(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(under_a_beam(tmp_path, 0.02, place_look_above_m=0.0)) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["live"].get("place_waits") == 3, "waits", 60.0)
            why = [line["why"] for line in cell.notes(run_id, "suspended")]
            assert why == [f"with an item above the place: while the tool went down, {OFF}"] * 3
            assert not gripper_of(cell).put_down
            await cell.engine.finish("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert counted(cell, run_id)["lost"] == 1
            assert told(cell, run_id).registers["place_waits"] == 3

    run_virtual(scene())


def test_a_place_that_is_taken_while_the_tool_goes_down_sends_it_up_again(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 3.0, picks=1)) as cell:
            run_id, place = await cell.start(), place_of(cell)
            await cell.until_state("place", 60.0)
            await goes_down_to(cell, 0.03)
            blocked = cell.clock.now()
            place.block(blocked)
            await waits(cell)
            assert not gripper_of(cell).put_down
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert gripper_of(cell).put_down[0].t > blocked + 3.0
            assert counted(cell, run_id)["picked"] == 1
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


@pytest.mark.parametrize("silent_s", [0.4, 1.5])
def test_nothing_is_put_down_while_the_input_is_silent(tmp_path: Path, silent_s: float) -> None:
    """The longer silence loses the device: the step is taken again, with the item in the gripper."""

    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 0.0, picks=1)) as cell:
            run_id = await cell.start()
            await cell.until_state("place", 60.0)
            await goes_down_to(cell, 0.04)
            silent = cell.clock.now()
            cell.plant.plant("place_inputs").inject("silence", {"duration_s": silent_s})
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert gripper_of(cell).put_down[0].t > silent + silent_s
            assert counted(cell, run_id)["picked"] == 1
            assert len(cell.notes(run_id, "interrupted")) == (silent_s > 1.0)
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_after_an_interruption_the_item_is_put_down_only_when_the_place_is_clear(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 6.0, picks=1)) as cell:
            run_id, place = await cell.start(), place_of(cell)
            await cell.until_state("lift", 60.0)
            place.block(blocked := cell.clock.now())
            cell.plant.plant("belt").inject("silence", {"duration_s": 1.0})
            await waits(cell)
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert gripper_of(cell).put_down[0].t > blocked + 6.0
            assert counted(cell, run_id)["picked"] == 1
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_after_an_interruption_a_place_that_is_taken_on_the_way_down_is_waited_for(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 3.0, picks=1)) as cell:
            run_id, place = await cell.start(), place_of(cell)
            await cell.until_state("lift", 60.0)
            cell.plant.plant("belt").inject("silence", {"duration_s": 1.0})
            await cell.until_state("to-wait", 60.0)
            await goes_down_to(cell, 0.03)
            place.block(blocked := cell.clock.now())
            lowest = np.inf
            while cell.clock.now() < blocked + 0.5:
                await cell.clock.sleep(0.01)
                lowest = min(lowest, above_place(cell)[2])
            assert lowest > 0.005, "seen at the next look"
            await waits(cell)
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert gripper_of(cell).put_down[0].t > blocked + 3.0
            assert counted(cell, run_id)["picked"] == 1
            assert cell.result(run_id)["result"]["place_waits"]["count"] == 1

    run_virtual(scene())


def test_a_wait_can_be_paused_and_goes_on_with_the_item_in_the_gripper(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 10.0, picks=2)) as cell:
            run_id = await cell.start()
            await waits(cell)
            await cell.engine.pause("test")
            await cell.until(lambda: cell.engine.packml.name == "HELD", "held", 5.0)
            await cell.clock.sleep(10.0)
            assert len(gripper_of(cell).put_down) == 1, "held: also when the place is clear by now"
            await cell.engine.resume("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert counted(cell, run_id)["picked"] == 2
            assert cell.result(run_id)["result"]["place_waits"]["count"] == 1
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_a_wait_can_be_finished_and_the_item_in_the_gripper_counts_as_lost(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 1e5)) as cell:
            run_id = await cell.start()
            await waits(cell)
            await cell.engine.finish("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert len(gripper_of(cell).put_down) == 1
            outcomes = counted(cell, run_id)
            assert (outcomes["picked"], outcomes["lost"]) == (1, 1)

    run_virtual(scene())


def test_an_input_that_the_device_does_not_have_is_refused_by_name(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, 1.0, place_clear="free")) as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["error"]["name"] == "ARGUMENT_INVALID"
            assert "place_clear = 'free' is no input of place_inputs: it has clear" in str(end["error"])

    run_virtual(scene())


def test_check_finds_an_input_that_its_device_does_not_have(tmp_path: Path) -> None:
    config = config_of(tmp_path, 1.0)
    section = type("Section", (), {"inputs": {"place_free": None, "box_there": None}})()
    setup = setup_of(config)
    setup = replace(setup, devices={**setup.devices, "place_inputs": section})
    job = BeltTrackingConfig.model_validate(config.job[JOB])
    found = belt_expectation(setup, job)["problems"]
    assert found == [
        "place_clear = 'clear' is no input of [device.place_inputs], which has place_free, box_there; "
        "correct the name, or add the input there"
    ]
