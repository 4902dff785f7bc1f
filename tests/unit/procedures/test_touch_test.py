"""The tool's point over corners of a board, on virtual time, beside what was done to tool and camera."""

import json
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cell.calibrations import laser_reference
from cell.errors import error
from cell.procedure import Run
from daemon.predictions import setup_of
from daemon.words.plan_text import plan_text
from fakes.object import run_virtual
from fakes.world.obstacle import Obstacle
from procedures.beside_truth import Judged
from procedures.documents import read_result
from procedures.hand_eye.config import ConeCaptureConfig
from procedures.hand_eye_in_use import HAND_EYE
from procedures.touch_test.config import TouchTestConfig
from procedures.touch_test.expectation import touch_expectation
from procedures.touch_test.judging import solve_touch_test
from procedures.touch_test.procedure import TouchTest
from procedures.touch_test.states import State
from procedures.touch_test.truth import judge_touch
from procedures.touch_test.words import touch_lines
from procedures.words import deg, mm
from tests.kit.object_cell import WHO, ObjectCell, no_report, on_disk, open_cell, refused
from tests.kit.slot_cell import HAND_EYE_COV, give_hand_eye
from tests.kit.touch_cell import HASTY, TOUCH, Toucher, touch_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

Scene = Callable[[ObjectCell, Toucher], Awaitable[None]]


def scene_of(folder: Path, act: Scene, **job: Any) -> None:
    """``act`` in an open cell; the arm rests at the end."""

    async def main() -> None:
        async with open_cell(touch_config(folder, **job), job=TOUCH) as cell:
            await act(cell, Toucher(cell))
            assert cell.at_rest()

    run_virtual(main())


async def run_of(cell: ObjectCell, person: Toucher) -> dict[str, Any]:
    """A test whose person stands over all four corners; its result."""
    number = await cell.start()
    for _ in range(4):
        await person.stand()
    end = await cell.finished(number)
    assert end["outcome"] == "complete", end
    return cell.result(number)


def test_nothing_is_off_in_a_true_cell_and_the_point_was_driven_over_the_corners(tmp_path: Path) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        lens = cell.plant.world.intrinsics
        solved = {"width": lens.width, "height": lens.height, "K": list(lens.K), "dist": list(lens.dist)}
        size = {"x": 1e-6, "y": -1e-6, "sigma_x": 1e-5, "sigma_y": 1e-5}
        give_hand_eye(cell, lens={**solved, "rms_px": 0.1}, target_scale=size)
        give_reference(cell)
        found = await run_of(cell, person)
        assert (found["verdict"], found["warnings"]) == ("pass", [])
        judged = beside_truth(cell, found)
        assert (judged.good, judged.inside95) == (True, True), judged.text
        answer, of = found["result"], found["uncertainty"]
        assert judged.stated == (
            f"shift {mm(answer['shift_m'])} +- {mm(of['shift_95_m'])}, "
            f"turn {deg(answer['turn_rad'])} +- {deg(of['turn_95_rad'])} (95 %)"
        )
        nothing = f"shift by {mm(answer['shift_m'])}, turn by {deg(answer['turn_rad'])} (truly 0.000 mm and "
        assert judged.off == f"{nothing}0.0000 deg)"
        data = json.loads((cell.folder(1).path / "touch-test.json").read_text("utf-8"))
        assert data["look"]["lens"] == {**solved, "sigma": None}
        assert data["look"]["printed"] == size
        assert shift_with_another_told_lens(cell.folder(1).path, tmp_path) == found["result"]["shift"]
        assert data["tool_reference"] == [0.001, 0.002, 0.18]
        assert found["result"]["shift_m"] < found["uncertainty"]["shift_95_m"] < 0.001
        assert found["result"]["chance"] > 0.01
        # Driven there before anybody jogged: at the stand-off over each corner.
        assert person.heights == pytest.approx([0.003] * 4, abs=0.0005)
        assert [c["corner"] for c in found["result"]["corners"]] == [0, 8, 53, 45]
        lines = "\n".join(touch_lines(read_result(found)))  # type: ignore[arg-type]
        assert "off at the board by" in lines
        assert "hand-eye" in lines
        folder = cell.folder(1)
        again = TouchTest.solve_again(folder.path / "touch-test.json", folder.info, found)
        assert again.as_json()["result"] == found["result"]
        assert judged_of(folder.path, tmp_path, [0, 1, 2, 3]).startswith("corners-on-a-line: ")

    scene_of(tmp_path, act)


def beside_truth(cell: ObjectCell, found: dict[str, Any]) -> Judged:
    """The result of the first run beside the twin's truth."""
    return judge_touch(
        read_result(found),  # type: ignore[arg-type]
        cell.plant.world.truth(cell.clock.now()),
        cell.folder(1).path,
    )


def shift_with_another_told_lens(run: Path, folder: Path) -> list[float]:
    """Of the same run, had the camera told a focal length that is 0.25 % too long."""
    data = json.loads((run / "touch-test.json").read_text("utf-8"))
    data["look"]["camera"]["K"] = [1.0025 * k for k in data["look"]["camera"]["K"]]
    (folder / "touch-test.json").write_text(json.dumps(data), "utf-8")
    shift: list[float] = solve_touch_test(folder).as_json()["result"]["shift"]
    return shift


def give_reference(cell: ObjectCell) -> None:
    """A laser reference of the tool on the flange, as a run would have left it in effect."""
    tool = cell.config.robot.tool.name
    document = {"tool": {"id": tool, "p_ref": [0.001, 0.002, 0.18]}, "passes": []}
    entry = on_disk(cell.ledger.propose, laser_reference(tool), document, {}, 0, None)
    on_disk(cell.ledger.accept, entry, WHO)


def judged_of(run: Path, folder: Path, corners: list[int]) -> str:
    """The first reason of the same run with other corners."""
    data = json.loads((run / "touch-test.json").read_text("utf-8"))
    for at, corner in zip(data["stood"], corners, strict=True):
        at["corner"] = corner
    (folder / "touch-test.json").write_text(json.dumps(data), "utf-8")
    return solve_touch_test(folder).reasons[0]


def test_a_bent_tool_is_found_with_its_shift(tmp_path: Path) -> None:
    bend = np.array([0.0015, -0.001, 0.001])

    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell)
        cell.plant.world.tool.bend(cell.clock.now(), bend)
        found = await run_of(cell, person)
        assert found["verdict"] == "fail"
        assert found["reasons"][0].startswith("off: ")
        assert [w["code"] for w in found["warnings"]] == ["touch.tool-unchecked"]
        off, of = found["result"], found["uncertainty"]
        assert off["shift_m"] == pytest.approx(float(np.linalg.norm(bend)), abs=of["shift_95_m"])
        # The tool points into the board, so z is z; x and y are turned with it.
        assert abs(off["shift"][2]) == pytest.approx(bend[2], abs=of["shift_95_m"])
        assert off["turn_rad"] < of["turn_95_rad"]
        judged = beside_truth(cell, found)
        assert (judged.good, judged.inside95) == (True, True), judged.text
        assert "(truly 2.062 mm and 0.0000 deg)" in judged.off
        cell.plant.world.tool.bend(cell.clock.now(), np.array([0.0, 0.003, 0.0]))
        assert not beside_truth(cell, found).good

    scene_of(tmp_path, act)


def test_a_moved_camera_is_found_with_its_shift(tmp_path: Path) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell, [0.0015, 0.0, 0.001, 0.0, 0.0, 0.0])
        found = await run_of(cell, person)
        assert found["verdict"] == "fail"
        of = found["uncertainty"]
        assert found["result"]["shift_m"] == pytest.approx(np.hypot(0.0015, 0.001), abs=of["shift_95_m"])

    scene_of(tmp_path, act)


def test_a_point_far_from_its_corner_is_asked_for_again_and_a_corner_may_be_left_out(tmp_path: Path) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell)
        number = await cell.start()
        await person.stand((0.03, 0.0, -0.01))
        await person.stand()
        assert "mm from where the camera has this corner" in person.asked[1]
        assert (
            "leave the arm's reach, and confirm, or skip this corner: the arm moves then" in person.asked[0]
        )
        for answer in (cell.engine.confirm, cell.engine.skip):
            await answered_in_local_mode(cell, person, answer)
        await person.skip()
        assert all(text.startswith("The arm is still in local mode") for text in person.asked[-2:])
        assert "corner 2 of 4" in person.asked[-1]
        for _ in range(2):
            await person.stand()
        assert (await cell.finished(number))["outcome"] == "complete"
        found = cell.result(number)
        assert (found["inputs"]["corners"], found["inputs"]["skipped"]) == (3, [8])

    async def answered_in_local_mode(
        cell: ObjectCell, person: Toucher, answer: Callable[[int, str], Awaitable[None]]
    ) -> None:
        prompt = await person.prompt()
        cell.plant.controller.remote = False
        await cell.clock.sleep(0.1)
        await answer(prompt, WHO)
        await cell.clock.sleep(0.1)
        cell.plant.controller.remote = True

    scene_of(tmp_path, act)


def test_a_finish_at_a_corner_lifts_the_tool_and_says_that_it_was_too_early(tmp_path: Path) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell)
        number = await cell.start()
        await person.prompt()
        await cell.engine.pause(WHO)
        await person.stand()
        await cell.clock.sleep(5.0)
        assert person.height() == pytest.approx(0.003, abs=0.0005), "the pause holds the lift"
        await cell.engine.resume(WHO)
        await person.prompt()
        await cell.engine.finish(WHO)
        await cell.until(lambda: not cell.engine.active, "the end")
        assert cell.end(number)["outcome"] == "complete"
        assert person.height() == pytest.approx(0.053, abs=0.002)
        found = cell.result(number)
        assert (found["verdict"], found["result"]) == ("fail", None)
        assert found["reasons"][0].startswith("too-few-corners: ")

    scene_of(tmp_path, act)


def test_a_finish_at_a_pause_before_the_lift_ends_as_one_when_a_person_has_the_arm(tmp_path: Path) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell)
        number = await cell.start()
        await person.prompt()
        await cell.engine.pause(WHO)
        await person.stand()
        await cell.until_state("lift")
        cell.plant.controller.remote = False
        await cell.clock.sleep(0.1)
        await cell.engine.finish(WHO)
        await cell.until(lambda: not cell.engine.active, "the end")
        assert cell.end(number)["outcome"] == "complete", cell.end(number)
        assert person.height() == pytest.approx(0.003, abs=0.0005)
        assert "stood over 1 corners" in cell.result(number)["reasons"][0]
        assert [line["corner"] for line in cell.notes(number, "not lifted")] == [0]

    scene_of(tmp_path, act)


def raise_a_wall(cell: ObjectCell, person: Toucher) -> None:
    """A stiff board, and a tool that is 10 mm longer than it is known to be."""
    world, board = cell.plant.world, person.board()
    world.tool.bend(cell.clock.now(), np.array([0.0, 0.0, 0.01]))
    up = -board.rotation.apply([0.0, 0.0, 1.0])
    wall = Obstacle(point=board.translation.tolist(), normal=up.tolist(), stiffness_n_m=20e3)
    world.config = world.config.model_copy(update={"obstacle": [wall]})


def test_a_finish_while_the_arm_is_silent_after_a_force_lifts_the_tool(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    require, struck = Run._require_unbroken, list[str]()

    async def silent_once(run: Run, since: float) -> None:
        if run.state in (State.APPROACH, State.TOUCH) and not struck:
            struck.append("the look at the arm where the tool met something")
            run.finish()
            raise error("STALE_DATA", "the arm is silent at the end of the step")
        await require(run, since)

    monkeypatch.setattr(Run, "_require_unbroken", silent_once)

    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell)
        raise_a_wall(cell, person)
        number = await cell.start()
        await cell.until(lambda: not cell.engine.active, "the end")
        assert struck
        assert cell.end(number)["outcome"] == "complete", cell.end(number)
        assert cell.notes(number, "met something")
        assert person.height() > 0.045

    scene_of(tmp_path, act)


def test_a_tool_that_meets_the_board_is_stopped_and_not_lifted_by_a_finish_in_local_mode(
    tmp_path: Path,
) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell)
        raise_a_wall(cell, person)
        number = await cell.start()
        prompt = await person.prompt()
        assert person.asked[0].startswith("The tool met something, 20 N or more, ")
        assert -0.002 < person.height() < 0.0, "20 N at 20 N/mm, and not 7 mm deep"
        await cell.engine.confirm(prompt, WHO)
        await person.over(prompt)
        await person.prompt()
        assert person.asked[1].startswith("The tool still stands where it met something. At corner 1 of 4")
        cell.plant.controller.remote = False
        await cell.clock.sleep(0.1)
        await cell.engine.finish(WHO)
        await cell.until(lambda: not cell.engine.active, "the end")
        assert cell.end(number)["outcome"] == "complete", cell.end(number)
        assert person.height() < 0.0, "a person has the arm"
        assert cell.result(number)["reasons"][0].startswith("too-few-corners: ")

    scene_of(tmp_path, act)


@pytest.mark.parametrize(("clear_m", "higher"), [(0.05, ""), (0.009, " and clear_m")])
def test_a_height_that_is_not_known_to_the_stand_off_is_refused(
    tmp_path: Path, clear_m: float, higher: str
) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell, cov=900.0 * HAND_EYE_COV)
        refusal = await refused(cell.dry_run())
        assert refusal.name == "ARGUMENT_INVALID"
        assert f"take a thicker gauge and a larger stand_off_m{higher}, measure the" in str(refusal)

    scene_of(tmp_path, act, clear_m=clear_m)


def test_corners_are_numbers_of_points_each_named_once() -> None:
    for wrong in ([-1, 0, 1, 8], [0, 1, 8, 8]):
        with pytest.raises(ValidationError, match="corners"):
            TouchTestConfig(**HASTY, corners=wrong)


def test_a_way_down_that_no_force_could_end_is_refused() -> None:
    for wrong in ({"stand_off_m": 0.05}, {"stand_off_m": 0.02, "clear_m": 0.008}, {"clear_m": 0.0079}):
        with pytest.raises(ValidationError, match="raise clear_m, or lower stand_off_m"):
            TouchTestConfig(**HASTY, **wrong)
    assert TouchTestConfig(**HASTY, stand_off_m=0.003, clear_m=0.008).clear_m == 0.008


def test_a_reference_of_another_tool_is_none_of_this_one(tmp_path: Path) -> None:
    setup = setup_of(touch_config(tmp_path))
    for tool, cautions in ((setup.values.tool["name"], 0), ("other", 1)):
        rows = [{"name": name, "state": "committed"} for name in (HAND_EYE, laser_reference(tool))]
        known = replace(setup, calibrations=lambda rows=rows: rows)
        assert len(touch_expectation(known, TouchTestConfig(**HASTY))["cautions"]) == cautions


def test_check_says_from_how_near_a_board_of_badly_known_size_has_to_be_looked_at(tmp_path: Path) -> None:
    setup, job = setup_of(touch_config(tmp_path)), TouchTestConfig(**{**HASTY, "target": "other"})
    thick = TouchTestConfig(**{**HASTY, "target": "other", "stand_off_m": 0.007, "clear_m": 0.02})
    board = setup.values.targets["board"]
    sized, measured, bare = ({"other": {**board, "scale_sigma": sigma}} for sigma in (0.002, 0.0002, None))
    in_hand, fixed = ConeCaptureConfig(target="other"), ConeCaptureConfig(target="other", setup="eye-to-hand")
    for touching, targets, jobs, expected in (
        (job, bare, [], True),
        (job, sized, [], True),
        (job, bare, [ConeCaptureConfig(target="board")], True),
        (job, bare, [fixed], True),
        (job, bare, [in_hand], False),  # which finds the size
        (job, measured, [], False),
        (thick, bare, [], False),  # 7 mm are three standard deviations of what 1.17 m make of 0.2 %
    ):
        known = replace(setup, values=replace(setup.values, targets=targets), jobs=jobs)
        told = [t for t in touch_expectation(known, touching)["cautions"] if "scale_sigma" in t]
        assert bool(told) is expected
        near = f"from nearer than {job.stand_off_m / 0.006:.2f} m: the size of 'other' is known to 0.2 %"
        assert not told or near in told[0]


def test_a_dry_run_lists_the_corners_as_they_are_seen_and_moves_nothing(tmp_path: Path) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        give_hand_eye(cell)
        planned = plan_text((await cell.dry_run())["plan"])
        assert [f"corner {k}" in planned for k in (0, 8, 53, 45)] == [True] * 4
        assert cell.plant.world.track.at(cell.clock.now())[0].tolist() == cell.config.poses["home"]

    scene_of(tmp_path, act)


def test_corners_that_the_guard_forbids_are_refused_before_the_first_of_them(tmp_path: Path) -> None:
    async def main() -> None:
        config = touch_config(tmp_path)
        config.limits.workspace[0].min[2] = 0.3  # the board is below that
        async with open_cell(config, job=TOUCH) as cell:
            give_hand_eye(cell)
            end = await cell.finished(await cell.start())
            assert end["error"]["name"] == "MOTION_COLLISION"
            assert not [line for line in cell.journal(1) if line.get("state") == "approach"]
            assert cell.at_rest()

    run_virtual(main())


def test_what_is_missing_is_refused_before_anything_moves(tmp_path: Path) -> None:
    async def act(cell: ObjectCell, person: Toucher) -> None:
        assert (await refused(cell.start())).name == "HAND_EYE_UNKNOWN"
        for wrong in ({"target": "other"}, {"look_pose": "other"}, {"corners": [0, 1, 8, 54]}):
            assert (await refused(cell.start(params=wrong))).name == "ARGUMENT_INVALID"
        give_hand_eye(cell)
        setup = setup_of(cell.config)
        assert "2.0 mm" in touch_expectation(setup, TouchTestConfig(**HASTY, stand_off_m=0.002))["text"]
        bad = TouchTestConfig(**{**HASTY, "look_pose": "nowhere"}, corners=[0, 1, 8, 54])
        assert len(touch_expectation(setup, bad)["problems"]) == 2

    scene_of(tmp_path, act)
