"""What ``check`` says of targets that no picture shows, or too few points of, before anything moves."""

from dataclasses import replace
from pathlib import Path

import pytest

from daemon.predictions import setup_of
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.eye_to_hand.expectation import eye_to_hand_expectation
from procedures.hand_eye.config import ConeCaptureConfig, corners_needed
from procedures.hand_eye.expectation import cone_expectation
from procedures.setup import Setup
from procedures.touch_test.config import TouchTestConfig
from procedures.touch_test.expectation import touch_expectation
from tests.kit.object_cell import write_config

TAG = {"type": "aruco-marker", "dictionary": "DICT_4X4_50", "id": 3, "size_m": 0.06}
POINTS = {"type": "points", "points": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0]]}


@pytest.fixture
def setup(tmp_path: Path) -> Setup:
    cell = setup_of(write_config(tmp_path))
    return replace(cell, values=replace(cell.values, targets={"tag": TAG, "points": POINTS}))


def test_a_single_marker_needs_no_min_corners(setup: Setup) -> None:
    found = cone_expectation(setup, ConeCaptureConfig(target="tag", poses_per_placement=8))
    assert not any("min_corners" in text for text in found["problems"])
    assert "expected error" in found["text"]
    job = EyeToHandCheckConfig(target="tag", T_marker_flange=[0.0] * 6)
    assert not any("min_corners" in text for text in eye_to_hand_expectation(setup, job)["problems"])


def test_more_corners_than_the_target_has_are_a_problem(setup: Setup) -> None:
    found = cone_expectation(setup, ConeCaptureConfig(target="tag", min_corners=8))
    assert found["problems"] == ["min_corners is 8, and the target 'tag' has 4 points; lower it"]
    assert "expected error" not in found["text"]
    job = EyeToHandCheckConfig(target="tag", T_marker_flange=[0.0] * 6, min_corners=8)
    assert found["problems"][0] in eye_to_hand_expectation(setup, job)["problems"]


@pytest.mark.parametrize(("given", "points", "needed"), [(None, 4, 4), (None, 54, 8), (5, 54, 5)])
def test_a_frame_must_show_eight_points_or_all_of_a_smaller_target(
    given: int | None, points: int, needed: int
) -> None:
    assert corners_needed(given, points) == needed


def test_points_without_a_look_are_no_target_of_a_job(setup: Setup) -> None:
    words = "target 'points' is of the type points, which no picture shows; use one that is printed"
    assert cone_expectation(setup, ConeCaptureConfig(target="points", min_corners=4))["problems"] == [words]
    job = EyeToHandCheckConfig(target="points", T_marker_flange=[0.0] * 6, min_corners=4)
    assert words in eye_to_hand_expectation(setup, job)["problems"]
    assert words in touch_expectation(setup, TouchTestConfig(target="points", look_pose="home"))["problems"]


@pytest.mark.parametrize(("poses", "told"), [(7, True), (8, False)])
def test_an_odd_number_of_poses_is_told(setup: Setup, poses: int, told: bool) -> None:
    job = ConeCaptureConfig(target="tag", min_corners=4, poses_per_placement=poses)
    cautions = cone_expectation(setup, job)["cautions"]
    assert [text.partition(":")[0] for text in cautions] == [
        f"poses_per_placement is {poses}, an odd number"
    ] * told
