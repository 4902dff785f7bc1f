"""How a capture asks for its placements: bases and tilts, a board that was not moved, one badly placed."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.kinematics import robot_from_spec
from calibration.planning import ConeRequest, ConeShape, EyeInHand, RejectedPose
from calibration.targets import make_target
from cell.devices import Intrinsics
from cell.errors import error
from cell.poses import Array
from fakes.object import run_virtual
from procedures.hand_eye.advice import lost_text, where_to_move
from procedures.hand_eye.config import ConeCaptureConfig
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

BOARD = {
    "type": "charuco",
    "squares_x": 10,
    "squares_y": 7,
    "square_m": 0.025,
    "marker_m": 0.018,
    "dictionary": "DICT_5X5_100",
}
Act = Callable[[ObjectCell, int], Any]
SMALL = {"poses_per_placement": 3, "frames_per_pose": 1, "settle_s": 0.0, "seek_timeout_s": 1.0}


async def confirm(cell: ObjectCell, prompt: int) -> None:
    await cell.engine.confirm(prompt, WHO)


async def moved(cell: ObjectCell, prompt: int) -> None:
    cell.plant.world.operator.move_on(cell.clock.now())
    await cell.engine.confirm(prompt, WHO)


async def skip(cell: ObjectCell, prompt: int) -> None:
    await cell.engine.skip(prompt, WHO)


async def finish(cell: ObjectCell, prompt: int) -> None:
    await cell.engine.finish(WHO)


def texts_of(
    folder: Path,
    job: dict[str, Any],
    answers: Sequence[Act],
    before: Callable[[ObjectCell], None] | None = None,
) -> tuple[list[str], dict[str, Any], list[dict[str, Any]]]:
    """The prompts of a run whose operator gives these answers, its end, and its poses."""

    async def main() -> tuple[list[str], dict[str, Any], list[dict[str, Any]]]:
        async with open_cell(write_config(folder, job={**SMALL, **job})) as cell:
            if before is not None:
                before(cell)
            run_id, texts = await cell.start(placed=False), []
            for answer in answers:
                await cell.until(lambda: cell.engine.status()["prompt"], "a prompt", 120.0)
                prompt = cell.engine.status()["prompt"]
                texts.append(prompt["text"])
                assert (prompt["skippable"], cell.engine.status()["packml"]) == (True, "HELD")
                assert cell.at_rest()
                await answer(cell, prompt["id"])
            await cell.until(lambda: not cell.engine.active, "an end", 120.0)
            return texts, cell.end(run_id), cell.poses(run_id)

    return run_virtual(main())


def test_bases_and_tilts_are_asked_for_in_their_order_and_written_down(tmp_path: Path) -> None:
    job = {"placements": None, "bases": 2, "tilts": 2}
    texts, end, poses = texts_of(tmp_path, job, [confirm, moved, moved, turned])
    assert end["outcome"] == "complete"
    assert [text.partition(", in view")[0] for text in texts] == [
        "Placement 1 of 4 (base 1 of 2, tilt 1 of 2): put the board on its stand",
        "Placement 2 of 4 (base 1 of 2, tilt 2 of 2): tilt the board on its stand",
        "Placement 3 of 4 (base 2 of 2, tilt 1 of 2): move the stand to another place",
        "Placement 4 of 4 (base 2 of 2, tilt 2 of 2): tilt the board on its stand",
    ]
    assert [(o["group"], o["base"]) for o in poses[::3]] == [(0, 0), (1, 0), (2, 1), (3, 1)]


async def turned(cell: ObjectCell, prompt: int) -> None:
    world = cell.plant.world
    stands = world.T_mount_target[2]
    world.T_mount_target[2] = stands * RigidTransform.from_rotation(Rotation.from_rotvec([0.1, 0.0, 0.0]))
    await cell.engine.confirm(prompt, WHO)


def test_a_board_that_was_not_moved_is_no_new_placement(tmp_path: Path) -> None:
    texts, end, poses = texts_of(tmp_path, {"placements": 2}, [confirm, confirm, moved])
    assert "the board has not moved since placement 1" in texts[2]
    assert (end["outcome"], len(poses)) == ("complete", 6)


def test_a_board_that_is_put_back_where_it_stood_before_the_last_one_is_found_out(tmp_path: Path) -> None:
    async def back(cell: ObjectCell, prompt: int) -> None:
        cell.plant.world.operator.confirm(0, cell.clock.now())
        await cell.engine.confirm(prompt, WHO)

    texts, end, poses = texts_of(tmp_path, {"placements": 3}, [confirm, moved, back, finish])
    assert "the board has not moved since placement 1" in texts[3]
    assert (end["outcome"], len(poses)) == ("complete", 6)


def put_away(cell: ObjectCell) -> None:
    cell.plant.world.operator.remove(cell.clock.now())


def test_a_board_that_is_not_seen_can_be_put_right_skipped_or_done_without(tmp_path: Path) -> None:
    texts, end, poses = texts_of(tmp_path, {"placements": 2}, [confirm, skip, moved], put_away)
    assert "the board was not seen" in texts[1]
    assert "put it in view of the camera, and see to the light, then confirm" in texts[1]
    assert texts[2].startswith("Placement 2 of 2: move the board")
    assert (end["outcome"], {o["group"] for o in poses}) == ("complete", {0})


def test_finishing_without_any_placement_says_that_there_is_nothing_to_solve(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job=SMALL)) as cell:
            put_away(cell)
            end = await cell.run_job()  # this operator finishes a job that has trouble
            assert end["error"]["name"] == "CAPTURE_INCOMPLETE"

    run_virtual(main())


def farther(cell: ObjectCell) -> None:
    mounts = cell.plant.world.T_mount_target
    outward = mounts[0].translation * [1.0, 1.0, 0.0]
    mounts[0] = RigidTransform.from_translation(0.1 * outward / np.linalg.norm(outward)) * mounts[0]


def test_a_badly_placed_board_is_told_and_stays_when_the_operator_says_so(tmp_path: Path) -> None:
    job = {"poses_per_placement": 12, "distance_m": 1.55}
    texts, end, poses = texts_of(tmp_path, job, [confirm, confirm], farther)
    assert "7 of 12 poses would leave the arm's reach: " in texts[1]
    assert "or leave it there to take 5 poses, then confirm. Or skip the placement, or finish" in texts[1]
    assert (end["outcome"], len(poses)) == ("complete", 5)


def test_the_place_where_most_poses_are_reached_is_named_with_its_way() -> None:
    model = robot_from_spec({"model": "ur10e"})
    q = np.array([0.0, -1.8, 1.8, -1.57, -1.57, 0.0])
    seen = RigidTransform.from_components([-0.1, -0.06, 0.5], Rotation.identity())
    mounting = EyeInHand.from_view(
        RigidTransform.from_translation([0.0, -0.08, 0.05]), model.forward(q), seen
    )
    points = make_target(BOARD).points
    camera = Intrinsics(1280, 800, (800.0, 800.0, 640.0, 400.0), ())
    shape = ConeShape(12, 0.44, 0.5)
    request = ConeRequest(mounting, shape, points, camera, seen, q)
    radius = float(np.linalg.norm(mounting.T_base_target.translation[:2]))

    def near(q_from: Array, q_to: Array) -> None:
        """Free as far as the board is now, less what a move by 0.1 m gives."""
        if np.linalg.norm(model.forward(q_to).translation[:2]) > radius:
            raise error("MOTION_COLLISION", "a wall")

    text = where_to_move(request, model, near, 12)
    assert text.startswith(("move the board 0.1 m towards the base", "move the board 0.2 m towards the base"))
    assert text.endswith("(12 poses are reached there)")
    assert where_to_move(request, model, near, 13).startswith("no place within 0.2 m helps")
    lost = [RejectedPose(k, "out of the arm's reach or joint range") for k in range(12)]
    lost += [RejectedPose(12, "part of the board would be behind the camera")]
    assert (
        lost_text(lost, 20) == "12 of 20 poses would leave the arm's reach, 1 would lose the board from view"
    )


def test_too_few_usable_poses_ask_for_the_placement_again_and_what_was_taken_stays(tmp_path: Path) -> None:
    visits = 0

    def once_away(cell: ObjectCell) -> None:
        def look() -> None:
            nonlocal visits
            if cell.engine.run is not None and cell.engine.run.state == "move":
                visits += 1
            if visits == 2:
                put_away(cell)

        cell.engine.subscribe(look)

    async def put_back(cell: ObjectCell, prompt: int) -> None:
        nonlocal visits
        visits = 3
        cell.plant.world.operator.put_back(cell.clock.now())
        await cell.engine.confirm(prompt, WHO)

    job = {"retries_per_pose": 0, "poses_per_placement": 4}
    texts, end, poses = texts_of(tmp_path, job, [confirm, put_back], once_away)
    assert "3 poses in a row could not be used, the last as the board shows in 0 of 1 frames" in texts[1]
    assert (end["outcome"], len(poses)) == ("complete", 4)
    assert {o["group"] for o in poses} == {0}, "the board stands where it stood, so it is one placement"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"bases": 2, "tilts": 3, "placements": 4}, "bases x tilts is 6; leave placements out"),
        ({"tilts": 3}, "tilts needs bases"),
        ({"bases": 30, "tilts": 3}, "at most 60"),
    ],
)
def test_bases_tilts_and_placements_that_contradict_each_other_are_refused(
    keys: dict[str, int], words: str
) -> None:
    with pytest.raises(ValidationError, match=words):
        ConeCaptureConfig.model_validate({"target": "board", **keys})


def test_bases_x_tilts_are_the_placements() -> None:
    assert ConeCaptureConfig.model_validate({"target": "b", "bases": 10, "tilts": 3}).placements == 30
