"""A slot by the marker beside it: what a look measures, its line in the budget, and what ``check`` finds."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cell.poses import Array, to_pose6
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.data import HandEyeKnown, LookTaken, SlotData
from procedures.slot.judging import BOARD, CAMERA, MeasuredSlot, measure
from procedures.slot.judging import MARKER as ROW
from procedures.slot.marking import marker_problem
from tests.kit.slot_cell import HAND_EYE_COV
from tests.kit.slot_scene import KNOWN, MARKER, Picture, look_at
from tests.unit.procedures.test_slot_setup import expected, section

PLACE_M = 5e-5
JOB = {**MARKER.model_dump(), "sigma_m": PLACE_M, "sigma_rad": 0.0}
Q = [-0.53, -1.57, 2.16, -2.16, -1.57, -0.53]


def measured(picture: Picture, folder: Path, budget: Any = (), **job: Any) -> MeasuredSlot:
    """What a look with this picture measures of slot 1, the camera's frame as the base."""
    cv2.imwrite(str(folder / "look.png"), picture.colour)
    camera = picture.camera
    look = LookTaken(
        what="opening",
        q=Q,
        T_base_camera=[0.0] * 6,
        T_base_slot=six(to_pose6(picture.expected.T_camera)),
        sigma=KNOWN.tolist(),
        colour=["look.png"],
        depth=[],
        camera={"width": camera.width, "height": camera.height, "K": camera.K, "dist": camera.dist},
        reach_m=0.012,
    )
    hand_eye = HandEyeKnown(
        T_flange_camera=[0.0, -0.08, 0.05, 0.0, 0.0, 0.0], cov=HAND_EYE_COV.tolist(), budget=budget
    )
    data = SlotData(
        job=section(slot=1, **job),
        robot={"model": "ur10e"},
        arm_rms_m=1e-4,
        hand_eye=hand_eye,
        T_flange_part=[0.0, 0.0, 0.26, 0.0, 0.0, 0.0],
        insert_q=Q,
    )
    return measure(data, look, folder)


def six(pose: Array) -> list[float]:
    return [float(v) for v in pose]


def test_marker_and_edges_find_the_same_slot_and_the_markers_place_is_in_the_budget(tmp_path: Path) -> None:
    picture = look_at(1, np.random.default_rng(5), marked=True)
    by_edges, by_marker = (measured(picture, tmp_path, **job) for job in ({}, {"marker": JOB}))
    apart = (by_edges.T_base_slot.inv() * by_marker.T_base_slot).translation
    assert np.abs(apart[:2]).max() < 2e-4
    assert by_edges.budget is not None
    assert by_marker.budget is not None
    rows = {row.source: row.error95_m for row in by_marker.budget.by_source}
    assert rows[ROW] == pytest.approx(2.4477 * PLACE_M, rel=0.2)
    assert ROW not in {row.source for row in by_edges.budget.by_source}
    assert by_marker.budget.predicted_95_m > by_edges.budget.predicted_95_m


def test_what_the_hand_eye_owes_to_its_board_stands_apart(tmp_path: Path) -> None:
    picture = look_at(1, np.random.default_rng(5), marked=True)
    causes = [{"block": "target", "t": 3e-4, "r": 0.0}, {"block": "noise", "t": 4e-4, "r": 0.0}]
    found = measured(picture, tmp_path, causes).budget
    assert found is not None
    rows = {row.source: row.error95_m for row in found.by_source}
    assert rows[BOARD] / rows[CAMERA] == pytest.approx(0.75)


def test_the_place_of_a_marker_is_in_what_check_says_is_left_open() -> None:
    found = expected(section(marker={**JOB, "sigma_m": 1e-4}))
    alone = 2.4477 * (1e-8 + 1e-8 + (1.803e-3 * 0.06) ** 2) ** 0.5
    assert found["part_and_rack_95_m"] == pytest.approx(alone, rel=1e-3)
    assert "part, rack and marker alone leave" in found["text"]
    assert found["cautions"][0].startswith("part, rack and marker alone take most of the room")
    refused = expected(section(marker={**JOB, "sigma_m": 5e-4}))["problems"][0]
    assert "with marker.sigma_m, alone leave" in refused


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"dictionary": "DICT_NONE"}, "DICT_5X5_100"),
        ({"id": 45}, "marker.id counts to 50 at the last slot, and DICT_4X4_50 ends at 49"),
    ],
)
def test_a_marker_that_does_not_exist_is_told_in_words(changes: dict[str, Any], words: str) -> None:
    job = section(marker={**JOB, **changes})
    assert words in str(marker_problem(SlotInsertionConfig.model_validate(job)))
    assert any(words in problem for problem in expected(job)["problems"])
