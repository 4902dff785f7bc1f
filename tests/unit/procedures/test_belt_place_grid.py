"""Items are put into the places of a grid, one after the other, each place once."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.kinematics import robot_from_spec
from cell.guard import MotionGuard
from cell.poses import from_pose6
from daemon.config import CellConfig
from daemon.predictions import setup_of
from fakes.object import run_virtual
from fakes.world.belt.gripper import Gripper
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.expectation import belt_expectation
from procedures.belt.item_bookkeeping import ItemBookkeeping
from procedures.belt.items import CONTACT, Outcome
from procedures.belt.motion.places import Places
from procedures.belt.motion.tool_joints import ToolJoints
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import JOB, picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted, told

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

GRID = {"rows": 2, "columns": 2, "column_pitch_m": 0.08, "row_pitch_m": 0.06, "ask_empty": False}
SMALL = {"max_size_m": 0.07}


def config_of(folder: Path, grid: dict[str, Any] | None = None, **job: Any) -> CellConfig:
    keys = {"place_grid": {**GRID, **(grid or {})}, "items": SMALL, **job}
    return picking_config(folder, keys, {"spacing_m": "0.25"})


def tool_of(config: CellConfig) -> tuple[ToolJoints, np.ndarray]:
    """The tool, and the joints at the first place."""
    values = setup_of(config).values
    q_wait, q_place = (np.array(config.poses[name]) for name in ("wait", "place"))
    return ToolJoints(
        robot_from_spec(values.robot), from_pose6(values.tool["T_flange_tool"]), q_wait
    ), q_place


def expected(config: CellConfig) -> dict[str, Any]:
    """What ``check`` says of it."""
    return belt_expectation(setup_of(config), BeltTrackingConfig.model_validate(config.job[JOB]))


class Looked(MotionGuard):
    """A guard that allows everything and keeps what it was asked."""

    def __init__(self) -> None:
        self.looked: list[np.ndarray] = []

    def check_joints(self, q: np.ndarray) -> None:
        self.looked.append(q)


def raised(config: CellConfig, higher_m: float) -> CellConfig:
    """With the place so much higher."""
    tool, q_place = tool_of(config)
    here = tool.state(q_place).p
    there = here + np.array([0.0, 0.0, higher_m, 0.0])
    config.poses["place"] = [float(v) for v in tool.walked(here, there, q_place)]
    return config


def gripper_of(cell: ObjectCell) -> Gripper:
    gripper = cell.plant.world.gripper
    assert gripper is not None
    gripper.settle(cell.clock.now())
    return gripper


def put_down(cell: ObjectCell, heights_m: Sequence[float] = (0.0,)) -> np.ndarray:
    """(n, 2) m: where each item was put down, from the place pose along the tool's x and y there; they were
    ``heights_m`` above it."""
    world = cell.plant.world
    T = world.true.forward(np.array(cell.config.poses["place"])) * world.T_flange_tool
    there = T.inv().apply(np.array([put.at for put in gripper_of(cell).put_down]))
    assert np.abs(there[:, 2] + heights_m).max() < 1e-3  # the tool's z points down
    return np.asarray(there[:, :2])


def test_each_place_gets_one_item_row_by_row_and_a_full_grid_ends_the_job(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["live"].get("next_place") == 2, "place 2", 60.0)
            assert told(cell, run_id).registers["next_place"] == 2
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert told(cell, run_id).registers["next_place"] == 0
            wanted = [[0.0, 0.0], [0.08, 0.0], [0.0, 0.06], [0.08, 0.06]]
            assert put_down(cell) == pytest.approx(np.array(wanted), abs=1e-3)
            found = cell.result(run_id)["result"]["grid"]
            assert found == {"places": 4, "filled": 4, "next": 0, "renewed": 0}
            lives = [
                row["detail"]["history"] for row in cell.ledger.items(run_id) if row["outcome"] == "picked"
            ]
            assert [life[-2][1] for life in lives][:2] == [
                "place 1 of 4 (row 1, column 1)",
                "place 2 of 4 (row 1, column 2)",
            ]
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


@pytest.mark.parametrize("higher_m", [0.0, 0.1])
def test_the_tool_is_low_over_the_grid_only_in_a_place(tmp_path: Path, higher_m: float) -> None:
    """The tray is 0.1 m and 0.2 m above the belt; columns follow away from it."""
    along = {"rows": 1, "columns": 3, "columns_along": "-y", "rows_along": "x", "column_pitch_m": 0.08}
    config = raised(config_of(tmp_path, along), higher_m)

    async def scene() -> None:
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            q, world = np.array(cell.config.poses["place"]), cell.plant.world
            T = world.true.forward(q) * world.T_flange_tool
            places = np.array([[0.0, 0.0], [0.0, -0.08], [0.0, -0.16]])
            crossed = []
            while len(gripper_of(cell).put_down) < 3:
                await cell.clock.sleep(0.01)
                x, y, down = T.inv().apply(world.tool_point(cell.clock.now()))
                nearest = np.hypot(*(places - [x, y]).T).min()
                if 0.006 < nearest < 0.04:
                    crossed.append(-down)
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert len(gripper_of(cell).put_down) == 3
            assert min(crossed) > 0.045

    run_virtual(scene())


def test_a_full_grid_is_held_until_somebody_says_that_it_is_empty_again(tmp_path: Path) -> None:
    grid = {"rows": 1, "columns_along": "-y", "rows_along": "x", "when_full": "hold", "ask_empty": True}

    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, grid, picks=3)) as cell:
            run_id = await cell.start()
            asked = []
            for _ in range(2):
                await cell.until(lambda: cell.engine.status()["prompt"], "a prompt", 60.0)
                await cell.clock.sleep(2.0)
                assert cell.at_rest()
                asked.append(cell.engine.status()["prompt"]["text"])
                await cell.answer()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert asked == [
                "Items will be put into places 1 to 2. See that these are empty, then confirm.",
                "All 2 places are filled. See that all of them are empty again, then confirm.",
            ]
            assert put_down(cell) == pytest.approx(np.array([[0.0, 0.0], [0.0, -0.08], [0.0, 0.0]]), abs=1e-3)
            assert cell.result(run_id)["result"]["grid"] == {
                "places": 2,
                "filled": 3,
                "next": 2,
                "renewed": 1,
            }
            assert len(cell.notes(run_id, "places are empty again")) == 1

    run_virtual(scene())


def test_a_run_goes_on_at_the_place_that_it_is_given(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path)) as cell:
            run_id = await cell.start(params={"first_place": "4"})
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert put_down(cell) == pytest.approx(np.array([[0.08, 0.06]]), abs=1e-3)

    run_virtual(scene())


def test_an_item_that_fell_out_on_the_way_leaves_its_place_to_the_next(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, picks=1)) as cell:
            run_id = await cell.start()
            await cell.until_state("place", 60.0)
            assert gripper_of(cell).empty(cell.clock.now()) is not None
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert counted(cell, run_id)[Outcome.LOST] == 1
            assert put_down(cell) == pytest.approx(np.zeros((1, 2)), abs=1e-3)
            assert cell.result(run_id)["result"]["grid"]["filled"] == 1

    run_virtual(scene())


@pytest.mark.parametrize("state", ["place", "lift"])
def test_an_interruption_puts_what_is_held_at_a_place_that_nothing_lies_at(
    tmp_path: Path, state: str
) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, picks=3)) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["live"].get("next_place") == 2, "place 2", 60.0)
            await cell.until_state(state, 60.0)
            cell.plant.plant("belt").inject("silence", {"duration_s": 1.0})
            assert (await cell.finished(run_id))["outcome"] == "complete"
            where = put_down(cell)
            apart = np.linalg.norm(where[:, None] - where[None], axis=2) + np.eye(len(where))
            assert len(where) == 3
            assert apart.min() > 0.05
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


@pytest.mark.parametrize("as_stopped", [True, False])
def test_an_interruption_at_the_last_place_ends_the_job_as_a_full_grid_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_stopped: bool
) -> None:
    """A gripper that still holds the item lets go of it in its place, or keeps it where that is not known."""
    if not as_stopped:
        carry = ItemBookkeeping.carry
        monkeypatch.setattr(
            ItemBookkeeping, "carry", lambda self, item, if_empty: carry(self, item, Outcome.LOST)
        )
    keys = {"place_grid": {**GRID, "rows": 1, "columns": 1}, "items": SMALL}
    slow = {"spacing_m": "0.25", "confirm": "7\nopen_s = 1.9"}
    config = picking_config(tmp_path, {**keys, "grip_timeout_s": 5.0, "max_duration_s": 60.0}, slow)

    async def scene() -> None:
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["live"].get("next_place") == 0, "full", 60.0)
            cell.plant.plant("belt").inject("silence", {"duration_s": 1.0})
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert len(cell.notes(run_id, "interrupted")) == 1
            lives = [(row["outcome"], row["detail"]["history"]) for row in cell.ledger.items(run_id)]
            touched = [what for what, life in lives if CONTACT in [event for _, event in life]]
            assert touched == ["picked" if as_stopped else "lost"]
            found = cell.result(run_id)["result"]["grid"]
            assert found == {"places": 1, "filled": 1, "next": 0, "renewed": 0}
            if as_stopped:
                assert put_down(cell) == pytest.approx(np.zeros((1, 2)), abs=1e-3)

    run_virtual(scene())


def from_place(cell: ObjectCell) -> tuple[float, float]:
    """How far the tool's point is beside the place pose, and above it, m."""
    q, world = np.array(cell.config.poses["place"]), cell.plant.world
    place = (world.true.forward(q) * world.T_flange_tool).translation
    x, y, z = world.tool_point(cell.clock.now()) - place
    return float(np.hypot(x, y)), float(z)


async def interrupted_with_an_item(cell: ObjectCell) -> None:
    await cell.until_state("lift", 60.0)
    cell.plant.plant("belt").inject("silence", {"duration_s": 1.0})


def test_after_an_interruption_the_tool_leaves_the_place_straight_up(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, picks=1)) as cell:
            run_id = await cell.start()
            await interrupted_with_an_item(cell)
            await cell.until(lambda: gripper_of(cell).put_down, "an item that is put down", 60.0)
            lowest = np.inf
            while cell.engine.status().get("state") not in ("ready", "report"):
                await cell.clock.sleep(0.01)
                beside, above = from_place(cell)
                lowest = min(lowest, above) if 0.005 < beside < 0.12 else lowest
            assert 0.045 < lowest < np.inf
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(scene())


def test_after_an_interruption_the_tool_rises_to_a_place_that_is_higher_than_the_waiting_pose(
    tmp_path: Path,
) -> None:
    config = config_of(tmp_path, picks=1, place_grid=None)
    values = setup_of(config).values
    q_wait, q_place = (np.array(config.poses[name]) for name in ("wait", "place"))
    tool = ToolJoints(robot_from_spec(values.robot), from_pose6(values.tool["T_flange_tool"]), q_wait)
    here = tool.state(q_place).p
    there = here.copy()
    there[2] = tool.state(q_wait).p[2] + 0.05
    config.poses["place"] = [float(v) for v in tool.walked(here, there, q_place)]

    async def scene() -> None:
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            await interrupted_with_an_item(cell)
            await cell.until_state("to-wait", 60.0)
            start, risen = from_place(cell)[0], -np.inf
            while abs(from_place(cell)[0] - start) < 0.01:
                await cell.clock.sleep(0.01)
                risen = from_place(cell)[1]
            assert risen > 0.045
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert counted(cell, run_id)["picked"] == 1

    run_virtual(scene())


@pytest.mark.parametrize(
    ("state_of", "grid", "words"),
    [
        ("limits", {"columns": 8, "columns_along": "-x", "column_pitch_m": 0.3}, "cannot be used"),
        (
            "pitch",
            {"column_pitch_m": 0.05},
            "place_grid.column_pitch_m = 0.05 m is shorter than items.max_size_m",
        ),
        ("fits", {}, ""),
    ],
)
def test_check_looks_at_every_place(tmp_path: Path, state_of: str, grid: dict[str, Any], words: str) -> None:
    found = expected(config_of(tmp_path, grid))
    if state_of == "fits":
        assert not found["problems"]
        assert "place_grid" not in " ".join(found["cautions"])
    else:
        assert words in " ".join([*found["problems"], *found["cautions"]])
    assert bool(found["problems"]) is (state_of == "limits")


def test_a_place_out_of_reach_is_refused_before_anything_moves(tmp_path: Path) -> None:
    grid = {"columns": 8, "columns_along": "-x", "column_pitch_m": 0.3}

    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, grid)) as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert "place_grid: place" in str(end["error"])
            assert not cell.notes(run_id, "to-wait")

    run_virtual(scene())


@pytest.mark.parametrize(
    ("job", "words"),
    [
        ({"first_place": 3}, "first_place = 3, but there is no place_grid"),
        (
            {"first_place": 5, "place_grid": GRID},
            "first_place = 5 is beyond the last of 4 places of place_grid",
        ),
    ],
)
def test_a_first_place_that_is_not_there_is_refused(job: dict[str, Any], words: str) -> None:
    keys = {"wait_pose": "wait", "place_pose": "place", "zone": {"min_m": 0.0, "max_m": 0.3}, "belt_z_m": 0.0}
    with pytest.raises(ValueError, match=words):
        BeltTrackingConfig.model_validate({**keys, **job})


LAYER_M = 0.05
LAYERS = {"columns_along": "-y", "rows_along": "x", "rows": 1, "layers": 2, "layer_m": LAYER_M}


def test_layers_are_filled_from_below_and_the_level_ways_rise_with_them(tmp_path: Path) -> None:
    config = config_of(tmp_path, {"layers": 3, "layer_m": LAYER_M})
    tool, q_place = tool_of(config)
    job = BeltTrackingConfig.model_validate(config.job[JOB])
    subject = Places(job, tool, q_place)
    assert len(subject) == 12
    heights, levels = [], []
    while not subject.full:
        heights.append(subject.here.p[2])
        levels.append(subject.level_m)
        subject.take()
    assert np.diff(heights) == pytest.approx([0, 0, 0, LAYER_M, 0, 0, 0, LAYER_M, 0, 0, 0], abs=1e-9)
    assert np.subtract(levels, heights) == pytest.approx(job.above_m)
    assert subject.top_level_m == levels[-1] == subject.level_m
    assert subject.words(7) == "place 7 of 12 (layer 2, row 2, column 1)"
    subject.renew()
    assert subject.level_m == levels[0]


def test_items_are_put_on_each_other_and_crossed_above_the_layer_that_is_filled(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(config_of(tmp_path, LAYERS)) as cell:
            run_id, world = await cell.start(), cell.plant.world
            T = world.true.forward(np.array(cell.config.poses["place"])) * world.T_flange_tool
            crossed = []
            while cell.engine.active:
                await cell.clock.sleep(0.01)
                x, y, down = T.inv().apply(world.tool_point(cell.clock.now()))
                beside = np.hypot(x, y - np.array([0.0, -0.08])).min()
                lies_m = LAYER_M if len(gripper_of(cell).put_down) > 2 else 0.0  # what is highest there
                if 0.006 < beside < 0.04:
                    crossed.append(-down - lies_m)
            assert cell.end(run_id)["outcome"] == "complete"
            wanted = np.tile([[0.0, 0.0], [0.0, -0.08]], (2, 1))
            assert put_down(cell, (0.0, 0.0, LAYER_M, LAYER_M)) == pytest.approx(wanted, abs=1e-3)
            assert min(crossed) > 0.045
            assert cell.result(run_id)["result"]["grid"]["places"] == 4

    run_virtual(scene())


def test_check_knows_the_uppermost_layer(tmp_path: Path) -> None:
    flat, low, high = (
        expected(config_of(tmp_path, {"layers": count, "layer_m": None if count == 1 else LAYER_M}))
        for count in (1, 4, 40)
    )
    assert not low["problems"]
    assert any("as high as above_m over the grid" in problem for problem in high["problems"])
    assert low["speeds"][0]["cycle_s"] > flat["speeds"][0]["cycle_s"]


@pytest.mark.parametrize(
    ("items", "fall"),
    [
        ({"min_height_m": 0.02, "max_height_m": 0.04}, "items.min_height_m = 0.02 m"),
        ({"height_m": 0.02, "max_height_m": 0.04}, "items.height_m = 0.02 m"),
        ({"min_height_m": 0.039, "max_height_m": 0.04}, None),
    ],
)
def test_check_says_how_far_items_fall_that_are_lower_than_a_layer(
    tmp_path: Path, items: dict[str, float], fall: str | None
) -> None:
    grid = {"layers": 5, "layer_m": 0.04}
    cautions = expected(config_of(tmp_path, grid, items={**SMALL, **items}))["cautions"]
    told = [caution for caution in cautions if "fall 80.000 mm farther in layer 5" in caution]
    assert len(told) == (fall is not None)
    assert all(str(fall) in caution for caution in told)
    assert any("fall" in caution for caution in cautions) == (fall is not None)


def test_each_place_is_looked_at_from_one_next_to_it(tmp_path: Path) -> None:
    config = config_of(tmp_path, {"rows": 3, "layers": 2, "layer_m": LAYER_M})
    tool, q_place = tool_of(config)
    subject = Places(BeltTrackingConfig.model_validate(config.job[JOB]), tool, q_place)
    guard = Looked()
    assert subject.unreachable(guard) is None
    places = np.array([tool.state(q).p for q in guard.looked[::2]])  # the others are over them
    assert len(np.unique(places.round(4), axis=0)) == 12
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() == pytest.approx(0.08, abs=1e-4)


def test_the_cycle_counts_the_climb_before_a_high_grid_is_crossed(tmp_path: Path) -> None:
    grid, place = (
        expected(raised(config_of(tmp_path, **how), 0.2))["speeds"][0]["cycle_s"]
        for how in ({}, {"place_grid": None})
    )
    assert grid[0] > place[0] + 0.05


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ({"layers": 2}, "layers = 2 and layer_m belong together"),
        ({"layer_m": 0.05}, "layers = 1 and layer_m belong together"),
        ({"layers": 2, "layer_m": 0.01}, "would be pressed on those below"),
        ({"layers": 50, "rows": 3, "columns": 3, "layer_m": 0.05}, "450 places are more than 400"),
    ],
)
def test_layers_that_make_no_sense_are_refused(grid: dict[str, Any], words: str) -> None:
    keys = {"wait_pose": "wait", "place_pose": "place", "zone": {"min_m": 0.0, "max_m": 0.3}, "belt_z_m": 0.0}
    with pytest.raises(ValueError, match=words):
        BeltTrackingConfig.model_validate({**keys, "place_grid": {**GRID, **grid}})
