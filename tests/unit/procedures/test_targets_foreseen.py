"""What ``cellward check`` says of the targets of a check of a fixed camera, before anything moves."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.planning import board_centre
from calibration.targets import make_target
from cell.poses import exp_xi, from_pose6, to_pose6
from daemon.predictions import found_in, setup_of
from procedures.expected_camera import expected_camera
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.eye_to_hand.expectation import eye_to_hand_expectation
from procedures.eye_to_hand.targets import TargetsAsGiven, TargetView, list_targets
from procedures.eye_to_hand.words import axbc_plan_lines
from procedures.setup import Setup
from tests.kit.check_cell import AWAY, BEHIND, CHECK, STEPS, check_cell, config, wanted
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.object_cell import no_report

__all__ = ["no_report"]
NEAR, ASIDE, FAR_OFF = STEPS[0], [0.18, 0.0, 0.1], [0.0, 0.0, 0.35]


def foreseen(folder: Path, *targets: Sequence[float], **job: Any) -> tuple[Setup, EyeToHandCheckConfig]:
    """The cell as configured, and its check with these ``targets``."""
    made = config(folder, targets=wanted(*map(list, targets)), **job)
    return setup_of(made), EyeToHandCheckConfig.model_validate(made.job_section(CHECK))


def test_a_target_out_of_reach_is_named_with_its_line_and_the_others_are_driven_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)
    config(tmp_path, targets=wanted(NEAR, AWAY))
    path = tmp_path / "cell.toml"
    (line,) = [n for n, text in enumerate(path.read_text().splitlines(), 1) if text.startswith("targets =")]
    done = command("check", "-c", path)
    assert done.code == 0
    at = f"{path}:{line}: {CHECK}"
    assert f"Warning: {at}: targets[1]: out of the arm's reach, so it is left out" in done.err
    assert "take it out of the list" in done.err
    assert "20 of 20 poses are reached from 'home'" in done.out
    assert "1 of 2 targets can be driven to" in done.out

    config(tmp_path, targets=wanted(AWAY, BEHIND))
    done = command("check", "-c", path)
    assert done.code == 2
    for key, why in (("targets[0]", "out of the arm's reach"), ("targets[1]", "part of the board would be")):
        assert f"Error: {at}: {key}: {why}" in done.err


def test_a_target_without_a_free_way_is_named_with_what_is_in_it(tmp_path: Path) -> None:
    setup, job = foreseen(tmp_path, STEPS[3], ASIDE)
    assert eye_to_hand_expectation(setup, job)["cautions"] == []
    camera = from_pose6(setup.nominal["T_base_camera_nominal"] or [])
    at = (camera * from_pose6(job.targets[1])).translation
    box = {"min": (at - 0.005).tolist(), "max": (at + 0.005).tolist(), "name": "post"}
    barred = replace(setup, values=replace(setup.values, limits={**setup.values.limits, "keep_out": [box]}))
    found = eye_to_hand_expectation(barred, job)
    (text,) = [text for text in found["cautions"] if text.startswith("targets[1]: ")]
    assert "'post'" in text
    assert not any(text.startswith("targets[0]: ") for text in found["cautions"])
    assert "1 of 2 targets" in found["text"]


def test_a_target_outside_of_the_poses_is_told_by_check_and_dry_run(tmp_path: Path) -> None:
    setup, job = foreseen(tmp_path, NEAR, FAR_OFF)
    found = eye_to_hand_expectation(setup, job)
    assert found["problems"] == []
    (text,) = found["cautions"]
    assert text.startswith("targets[1]: outside of the poses (0.88 m")
    assert "before the camera, poses are from 0.4 to 0.7 m" in text
    assert text.endswith(
        "move it, or set nearest_m, farthest_m, tilt_rad or, for the roll, start_pose for it"
    )
    wider = job.model_copy(update={"farthest_m": 1.0})
    assert eye_to_hand_expectation(setup, wider)["cautions"] == []


def test_a_target_with_its_middle_in_the_camera_is_left_out_like_others(tmp_path: Path) -> None:
    setup, job = foreseen(tmp_path, NEAR)
    table, camera = setup.values.targets[job.target], setup.nominal["T_base_camera_nominal"]
    place = [*map(float, board_centre(make_target(table).points)), 0.0, 0.0, 0.0]
    start = [float(v) for v in setup.values.poses["home"]]
    of = TargetsAsGiven(camera or [], [[0.0] * 6], [], start, job.volume())
    (row,) = list_targets(
        setup.values, TargetView(table, place, expected_camera(setup, "fixed_camera").table), of
    )
    assert row["why"].startswith("part of the board would be")
    assert row["outside"] == ""


@pytest.mark.usefixtures("no_report")
def test_a_dry_run_tells_of_a_target_outside_of_the_poses(tmp_path: Path) -> None:
    from fakes.object import run_virtual

    async def main() -> None:
        async with check_cell(config(tmp_path, poses=14, targets=wanted(NEAR, FAR_OFF))) as cell:
            plan = (await cell.dry_run())["plan"]
            assert [bool(t["outside"]) for t in plan["targets"]] == [False, True]
            assert "target 2: outside of the poses (0.88 m" in "\n".join(axbc_plan_lines(plan))

    run_virtual(main())


def test_the_hand_eye_in_effect_is_looked_at_before_the_nominal_one(tmp_path: Path) -> None:
    setup, job = foreseen(tmp_path, NEAR)
    behind = exp_xi([0.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    moved = to_pose6(from_pose6(setup.nominal["T_base_camera_nominal"] or []) * behind).tolist()
    row = {"name": "T_base_camera", "state": "committed", "value": moved}
    rows = [{**row, "state": "proposed", "value": [0.0] * 6}, row]
    found = eye_to_hand_expectation(replace(setup, calibrations=lambda: rows), job)
    poses, target = found["problems"]
    assert poses.startswith("poses: from 'home': ")
    assert target.startswith("targets[0]: out of the arm's reach")


def test_without_a_hand_eye_or_a_start_targets_are_said_to_be_unchecked(tmp_path: Path) -> None:
    setup, job = foreseen(tmp_path, NEAR)
    blind = replace(setup, nominal={**setup.nominal, "T_base_camera_nominal": None})
    (text,) = eye_to_hand_expectation(blind, job)["cautions"]
    assert text.startswith("targets: none was checked without a hand-eye")
    somewhere = job.model_copy(update={"start_pose": None})
    nowhere = replace(setup, values=replace(setup.values, poses={}))
    (text,) = eye_to_hand_expectation(nowhere, somewhere)["cautions"]
    assert text == "targets: none was checked without start_pose"


def test_a_check_that_cannot_begin_is_a_problem(tmp_path: Path) -> None:
    setup, job = foreseen(tmp_path, NEAR)
    unknown = job.model_copy(update={"start_pose": "attic"})
    assert eye_to_hand_expectation(setup, unknown)["problems"] == [
        "start_pose = 'attic' is not in [poses]; add the pose or name another"
    ]
    turned = exp_xi([0.0, 0.0, 0.0, np.pi, 0.0, 0.0])
    away = to_pose6(from_pose6(setup.nominal["T_base_camera_nominal"] or []) * turned).tolist()
    found = eye_to_hand_expectation(
        replace(setup, nominal={**setup.nominal, "T_base_camera_nominal": away}), job
    )
    (text,) = found["problems"]
    assert text.startswith("start_pose: with the arm at 'home' part of the board would be behind the camera")
    far = job.model_copy(update={"nearest_m": 2.5, "farthest_m": 2.6})
    (text,) = eye_to_hand_expectation(setup, far)["problems"]
    assert text.startswith("poses: from 'home': ")


def test_a_picture_that_is_assumed_only_warns(tmp_path: Path) -> None:
    setup, job = foreseen(tmp_path, [0.3, 0.3, 0.0])
    found = eye_to_hand_expectation(setup, job)
    assert found["problems"] == []
    assert any("of 1280 x 800 pixels and 77 degrees, which is assumed" in text for text in found["cautions"])
    lens = {"width": 1280, "height": 800, "K": [800.0, 800.0, 639.5, 399.5], "dist": [0.0] * 5}
    known = replace(setup, stated=lambda name: {"lens": lens})
    (text,) = eye_to_hand_expectation(known, job)["problems"]
    assert "of the image's edge" in text


def test_a_key_has_its_line_in_a_recipe_or_in_the_section_of_the_job() -> None:
    one: dict[str, Any] = {"job": "j", "problems": ["a[1]: no", "b.c: no", "d is no"], "recipe": "r"}
    lines = {("recipe", "r", "a", 1): "f:3: ", ("job", "j", "a", 1): "f:1: ", ("job", "j", "b", "c"): "f:2: "}
    assert found_in([one], "problems", lambda key: lines.get(key, "")) == [
        "f:3: recipe r, j: a[1]: no",
        "f:2: recipe r, j: b.c: no",
        "recipe r, j: d is no",
    ]
    assert found_in([one], "problems")[0] == "recipe r, j: a[1]: no"
