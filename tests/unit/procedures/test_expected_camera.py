"""By which camera ``cellward check`` foresees what a capture will see."""

from pathlib import Path
from typing import Any

import pytest

from cell.errors import present
from daemon.config import load_config
from daemon.predictions import prediction_of, setup_of
from procedures.expected_camera import expected_camera
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.eye_to_hand.expectation import eye_to_hand_expectation
from tests.kit.example_cell import whole_example

CAMERA = '[device.camera]\ndriver = "oak"\n'
ABOVE = '[device.belt_camera]\ndriver = "oak"\n'
HALF = {CAMERA: f"{CAMERA}width = 640\nheight = 400\n"}
LENS = {"width": 1280, "height": 800, "K": [1100.0, 1101.0, 644.0, 395.0], "dist": [0.1, 0.0, 0.0, 0.0, 0.0]}


def foreseen(folder: Path, changed: dict[str, str]) -> dict[str, Any]:
    folder.mkdir()
    config = load_config(whole_example(folder, changed))
    return present(prediction_of(config, "cone-capture"), "prediction")


def test_a_capture_is_foreseen_by_the_size_in_the_section_of_its_camera(tmp_path: Path) -> None:
    usual, half = foreseen(tmp_path / "a", {}), foreseen(tmp_path / "b", HALF)
    assert usual["text"].endswith("and a camera of 1280 x 800 pixels and 77 degrees")
    assert half["text"].endswith("and a camera of 640 x 400 pixels and 77 degrees")
    assert half["predicted"]["error95_t_m"] > 1.2 * usual["predicted"]["error95_t_m"]


@pytest.mark.parametrize(("width", "height", "focal"), [(1920, 1080, 1200.0), (1280, 720, 800.0)])
def test_pictures_of_another_shape_show_a_part_of_the_same_sight(
    width: int, height: int, focal: float, tmp_path: Path
) -> None:
    path = whole_example(tmp_path, {CAMERA: f"{CAMERA}width = {width}\nheight = {height}\n"})
    table = expected_camera(setup_of(load_config(path)), "flange_camera").table
    assert table["K"] == [focal, focal, (width - 1) / 2, (height - 1) / 2]


def test_a_lens_that_was_found_for_such_pictures_is_the_one_that_is_foreseen_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = foreseen(tmp_path / "a", {})
    monkeypatch.setattr(
        "daemon.predictions._stated_now", lambda _, name: {"lens": LENS} if name == "T_flange_camera" else {}
    )
    found, half = foreseen(tmp_path / "b", {}), foreseen(tmp_path / "c", HALF)
    assert found["text"].endswith(
        "the lens that the hand-eye in effect has for pictures of 1280 x 800 pixels"
    )
    assert found["predicted"]["error95_t_m"] < 0.95 * usual["predicted"]["error95_t_m"]
    assert half["text"].endswith("and a camera of 640 x 400 pixels and 77 degrees"), (
        "it is for larger pictures"
    )


def test_targets_of_a_fixed_camera_that_is_not_calibrated_are_looked_at_in_pictures_of_its_size(
    tmp_path: Path,
) -> None:
    config = load_config(whole_example(tmp_path, {ABOVE: f"{ABOVE}width = 640\nheight = 640\n"}))
    job = EyeToHandCheckConfig.model_validate(config.job_section("eye-to-hand-check"))
    aside = [*job.targets[0]]
    aside[0] += 0.25
    found = eye_to_hand_expectation(setup_of(config), job.model_copy(update={"targets": [aside]}))
    assert any("by a camera of 640 x 640 pixels and 53 degrees" in text for text in found["cautions"]), found
