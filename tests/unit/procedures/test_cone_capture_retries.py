"""What a capture does when poses fail: again, then leave out with a reason, then ask the operator."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fakes.object import run_virtual
from tests.kit.object_cell import ObjectCell, no_report, open_cell, refused, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def while_at_poses(
    cell: ObjectCell, poses: set[int], begin: Callable[[], None], end: Callable[[], None]
) -> None:
    """``begin`` when the arm settles at one of these visits (counted from 0), ``end`` at the next move."""
    visits, entered = 0, 0

    def look() -> None:
        nonlocal visits, entered
        run = cell.engine.run
        if run is None or run.state is None or len(run.visited) == entered:
            return
        entered = len(run.visited)
        if run.state.value == "move":
            visits += 1
            end()
        elif run.state.value == "settle" and visits - 1 in poses:
            begin()

    cell.engine.subscribe(look)


def run_losing_the_board(
    config: Any, poses: set[int], check: Callable[[ObjectCell, dict[str, Any]], None]
) -> None:
    async def main() -> None:
        async with open_cell(config) as cell:
            world = cell.plant.world

            def lose() -> None:
                world.operator.remove(cell.clock.now())

            def find() -> None:
                world.operator.put_back(cell.clock.now())

            while_at_poses(cell, poses, lose, find)
            end = await cell.run_job()
            check(cell, end)
            assert cell.at_rest()

    run_virtual(main())


def test_a_pose_without_the_board_is_tried_again_then_left_out_with_the_reason(tmp_path: Path) -> None:
    def check(cell: ObjectCell, end: dict[str, Any]) -> None:
        assert end["outcome"] == "complete"
        assert len(cell.poses(1)) == 4
        failed, (skipped,) = cell.notes(1, "pose failed"), cell.notes(1, "pose skipped")
        assert [n["attempt"] for n in failed] == [1, 2, 3]
        assert {n["pose"] for n in failed} == {skipped["pose"]}
        assert "the board shows in 0 of 2 frames" in skipped["why"]

    run_losing_the_board(write_config(tmp_path, job={"poses_per_placement": 5}), {1}, check)


def test_a_board_that_comes_back_in_time_costs_one_attempt(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            operator = cell.plant.world.operator

            def lose_for_a_moment() -> None:
                operator.remove(cell.clock.now())
                asyncio.get_running_loop().call_later(0.5, lambda: operator.put_back(cell.clock.now()))

            cell.at_state("settle", lose_for_a_moment)
            assert (await cell.run_job())["outcome"] == "complete"
            assert len(cell.poses(1)) == 4
            assert [n["attempt"] for n in cell.notes(1, "pose failed")] == [1]

    run_virtual(main())


def test_an_arm_that_moves_during_the_exposures_is_told_and_the_pose_taken_again(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            track = cell.plant.world.track

            def creep() -> None:
                cell.plant.controller.settle_past()
                now = cell.clock.now()
                track.start_joint_move(now, track.at(now)[0] + 0.0015, 0.01, 1.0)

            cell.at_state("capture", creep)
            assert (await cell.run_job())["outcome"] == "complete"
            assert len(cell.poses(1)) == 4
            (failed,) = cell.notes(1, "pose failed")
            assert "the flange moved" in failed["why"]

    run_virtual(main())


def test_a_board_that_moves_between_the_frames_is_told(tmp_path: Path) -> None:
    async def main() -> None:
        config = write_config(tmp_path, job={"frames_per_pose": 3, "max_corner_motion_px": 0.01})
        async with open_cell(config) as cell:
            await cell.run_job()
            _, held = cell.notes(1, "prompt")
            assert "3 poses in a row could not be used, the last as the board moved" in held["text"]
            assert all("the board moved" in n["why"] for n in cell.notes(1, "pose failed"))

    run_virtual(main())


def test_a_camera_that_repeats_one_picture_is_found_out(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            cell.at_state("plan", lambda: cell.plant.camera.inject("freeze"))
            end = await cell.run_job()
            assert end["error"]["name"] == "CAMERA_FAULT"
            assert "repeats one picture" in end["error"]["text"]

    run_virtual(main())


def test_a_plan_that_cannot_be_reached_says_why(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"distance_m": 2.5})) as cell:
            await cell.run_job()
            _, held = cell.notes(1, "prompt")
            assert "of 4 poses would leave the arm's reach" in held["text"], "the reason with its count"
            refusal = await refused(cell.start(dry_run=True))
            assert refusal.name == "PLAN_INFEASIBLE"

    run_virtual(main())


def test_no_board_at_all_is_told_after_the_configured_time(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"seek_timeout_s": 4.0})) as cell:
            cell.plant.camera.inject("lost-board")
            end = await cell.run_job()
            _, held = cell.notes(1, "prompt")
            (sought,) = (n["t"] for n in cell.journal(1) if n.get("state") == "seek")
            assert "the board was not seen" in held["text"]
            assert "at best 0 corners" in held["text"]
            assert 4.0 <= held["t"] - sought < 8.0
            assert end["error"]["name"] == "CAPTURE_INCOMPLETE"

    run_virtual(main())


@pytest.mark.parametrize("scenario", ["hand_eye:ideal", "hand_eye_to_hand:ideal"])
def test_six_small_moves_find_a_first_estimate_when_none_is_configured(scenario: str, tmp_path: Path) -> None:
    config = write_config(tmp_path, scenario, {"poses_per_placement": 8})
    bare = config.robot.model_copy(
        update={
            "T_flange_camera_nominal": None,
            "T_base_camera_nominal": None,
            "T_flange_target_nominal": None,
        }
    )

    async def main() -> None:
        async with open_cell(config.model_copy(update={"robot": bare})) as cell:
            shown = await cell.dry_run()
            assert "six small moves" in shown["plan"]["note"]
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "pass")
            (estimate,) = cell.notes(run_id, "first estimate")
            assert len(estimate["X"]) == 6
            assert len([n for n in cell.journal(run_id) if "search move" in n.get("why", "")]) == 6

    run_virtual(main())
