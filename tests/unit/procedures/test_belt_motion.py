"""Where the tool may be while it picks: over items, between the zone's edges, and open before it goes on."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError, error
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.items import Item, Outcome
from procedures.belt.motion.gripper_times import GripperTimes
from procedures.belt.motion.item_selection import ItemSelection
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

FACE_M = 0.18  # of the twin's items, in the base: the belt is at 0.15 m
CAREFREE = "7\nwithin_m = 0.05\nbelow_m_s = 1.0"  # fingers that take anything
REFUSING = "7\nwithin_m = 1e-6"  # fingers that close on nothing


def tool_points(cell: ObjectCell, since: float) -> np.ndarray:
    """(n, 3) m in the base, every 4 ms up to now, as it truly was."""
    gripper = cell.plant.world.gripper
    assert gripper is not None
    return np.array([gripper._tool(float(t)) for t in np.arange(since, cell.clock.now(), 0.004)])


def lowest(points: np.ndarray, where: Callable[[np.ndarray], np.ndarray]) -> float:
    """The least height over the items' faces where ``where`` holds of x, m; inf when it never does."""
    chosen = points[where(points[:, 0])]
    return float(np.min(chosen[:, 2])) - FACE_M if len(chosen) else np.inf


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"grip_m": -0.005}, "into the belt"),
        ({"grip_m": 0.06}, "grip_m must be smaller than above_m"),
        ({"items": {"max_height_m": 0.12}}, "too low to go"),
    ],
)
def test_heights_that_do_not_go_together_are_refused(keys: dict[str, Any], named: str) -> None:
    zone = {"min_m": 0.0, "max_m": 0.5}
    with pytest.raises(ValueError, match=named):
        BeltTrackingConfig(wait_pose="a", place_pose="b", zone=zone, belt_z_m=0.1, **keys)  # type: ignore[arg-type]


def test_fingers_that_reach_beside_an_item_come_down_straight_and_leave_so(tmp_path: Path) -> None:
    job = {"picks": 3, "grip_m": -0.015, "items": {"min_height_m": 0.02}}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, {"confirm": CAREFREE})) as cell:
            end = await cell.finished(await cell.start())
            assert end["outcome"] == "complete", end["error"]
            gripper = cell.plant.world.gripper
            assert gripper is not None
            assert np.linalg.norm(contact_errors(cell), axis=1).max() < 0.5e-3  # as the tips pass the face
            for contact in gripper.contacts:  # and gripped where it was asked for
                assert contact.distance_m == pytest.approx(0.015, abs=1e-3)

    run_virtual(scene())


def test_an_item_given_up_from_below_its_face_is_left_straight_up(tmp_path: Path) -> None:
    job = {"grip_m": -0.015, "items": {"min_height_m": 0.02}}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job)) as cell:
            run_id = await cell.start()
            await cell.until_state("descend")
            gripper, items = cell.plant.world.gripper, cell.plant.world.items
            assert gripper is not None
            assert items is not None

            def beside() -> np.ndarray:
                tip = gripper._tool(cell.clock.now())
                near = items.nearest(cell.clock.now(), tip)
                assert near is not None
                return np.asarray(tip - near[1])

            while beside()[2] > -0.005:
                await cell.clock.sleep(0.004)
            cell.plant.plant("belt").inject("wrap", {"before": 20})  # by a jump: the item's place is unknown
            low = []
            while cell.engine.active and cell.engine.status()["state"] != "return":
                await cell.clock.sleep(0.004)
            while (off := beside())[2] < 0.015:
                low.append(float(np.hypot(off[0], off[1])))
                await cell.clock.sleep(0.004)
            assert low
            assert max(low) < 0.004
            await cell.engine.finish("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(scene())


def test_fingers_that_do_not_close_are_not_waited_for_beyond_the_zone(tmp_path: Path) -> None:
    job = {"grip_timeout_s": 2.0}
    world = {"profile": "[{ speed_m_s = 0.25 }]", "confirm": REFUSING}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, world)) as cell:
            begun, run_id = cell.clock.now(), await cell.start()
            await cell.until(lambda: cell.ledger.items(run_id), "the end of an item", 30.0)
            await cell.clock.sleep(0.5)
            assert cell.ledger.items(run_id)[0]["outcome"] == Outcome.GRIP_FAILED.value
            assert lowest(tool_points(cell, begun), lambda x: x > 0.455) > 0.0005  # nobody touches there
            await cell.engine.finish("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(scene())


@pytest.mark.parametrize("fault", ["belt-stop", "belt-reverse"])
@pytest.mark.parametrize("state", ["approach", "descend"])
def test_a_belt_that_changes_its_mind_has_nobody_come_down_before_the_zone(
    tmp_path: Path, fault: str, state: str
) -> None:
    job = {"zone": {"min_m": 0.1, "max_m": 0.45}}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job)) as cell:
            begun, run_id = cell.clock.now(), await cell.start()
            await cell.until_state(state)
            cell.plant.plant("belt").inject(fault, {"accel": 1.0})
            await cell.clock.sleep(4.0)
            assert cell.engine.status()["state"] == "standing"
            assert lowest(tool_points(cell, begun), lambda x: x < 0.095) > 0.005
            await cell.engine.finish("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(scene())


@pytest.mark.parametrize("answer", [False, CellError])
def test_fingers_that_do_not_open_after_a_failed_grip_end_the_job(tmp_path: Path, answer: Any) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {}, {"confirm": REFUSING})) as cell:
            run_id = await cell.start()
            await cell.until_state("grip")
            gripper: Any = cell.context.device("gripper")

            async def release(timeout: float) -> bool:
                if answer is False:
                    return False
                raise error("CALL_TIMEOUT", f"no answer in {timeout:g} s")

            gripper.release = release
            end = await cell.finished(run_id)
            assert end["outcome"] == "aborted"
            assert end["error"]["name"] == ("GRIPPER_STUCK" if answer is False else "CALL_TIMEOUT")
            assert cell.at_rest()

    run_virtual(scene())


def test_an_item_that_lies_where_the_arm_may_not_go_is_let_pass_and_says_why(tmp_path: Path) -> None:
    rail = {"name": "rail", "min": [-1.0, 0.565, 0.0], "max": [1.0, 0.8, 0.2]}
    limits = {**Scenario.load("picking:ideal").cell.limits, "keep_out": [rail]}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {}, {"lateral_m": "0.06"}, limits=limits)) as cell:
            run_id = await cell.start()

            def ends() -> set[bool]:
                return {row["outcome"] == Outcome.OUT_OF_ZONE.value for row in cell.ledger.items(run_id)}

            await cell.until(lambda: len(ends()) == 2, "an item that is let pass, and another", 60.0)
            await cell.engine.finish("test")
            assert (await cell.finished(run_id))["outcome"] == "complete"
            rows = cell.ledger.items(run_id)
            passed = [row for row in rows if row["outcome"] == Outcome.OUT_OF_ZONE.value]
            assert {row["outcome"] for row in rows} > {Outcome.OUT_OF_ZONE.value}
            for row in passed:
                assert any("out of reach" in what for _, what in row["detail"]["history"])

    run_virtual(scene())


def test_noise_never_turns_the_tool_round() -> None:
    zone = {"min_m": 0.0, "max_m": 0.5}
    config = BeltTrackingConfig(wait_pose="a", place_pose="b", zone=zone, belt_z_m=0.1)  # type: ignore[arg-type]
    tool: Any = SimpleNamespace(heading=lambda: 0.0)
    choice = ItemSelection(config, SimpleNamespace(), tool, 0.0, 0.2, GripperTimes(1.0))  # type: ignore[arg-type]
    item, turns = Item(1, 0.0, 0.0, np.radians(89.0)), []
    for yaw in np.radians([89.0, 91.0, 89.5, 90.5, -89.0, 88.0]):
        item.yaw = float(yaw)
        turns.append(choice.yaw(item))
    assert np.ptp(turns) < np.radians(4.0)
    assert choice.yaw(Item(2, 0.0, 0.0, np.radians(170.0))) == pytest.approx(np.radians(-10.0))
