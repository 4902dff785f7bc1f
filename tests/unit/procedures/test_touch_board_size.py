"""A touch test on a board that is printed too small: as the hand-eye found it, and where nobody knows it."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.targets import make_target
from calibration.touch import outermost
from cell.formats.result import Envelope
from cell.poses import to_pose6
from cell.run_values import RunValues
from procedures.hand_eye_in_use import HAND_EYE, found_size
from procedures.touch_test.judging import solve_touch_test
from tests.kit.imperfect_cell import CAMERA

SMALL = -0.002
BOARD = {"type": "chessboard", "columns": 9, "rows": 6, "square_m": 0.03, "flatness_m": 1e-5}
FOUND = {"x": SMALL, "y": SMALL, "sigma_x": 1e-4, "sigma_y": 1e-4}
STAND_OFF_M, TIP = 0.003, np.array([0.0, 0.0, 0.18])
FOLDED = RigidTransform.from_translation(TIP).inv()


def judged(folder: Path, board: dict[str, Any] = BOARD, **look: Any) -> Envelope:
    """Nothing is off but the print: a camera on the tool's own frame looks down at the board from half a
    metre, and the tool's point stands over its true corners."""
    points = make_target(board).points * [1.0 + SMALL, 1.0 + SMALL, 1.0]
    camera = RigidTransform.from_components([0.5, 0.1, 0.6], Rotation.from_euler("xz", [np.pi, 0.4]))
    C = RigidTransform.from_components([-0.1, -0.08, 0.5], Rotation.from_rotvec([0.15, -0.1, 0.2]))
    T_board, q = camera * C, [0.4, -1.4, 1.7, -1.9, -1.5708, 0.3]
    uv = cv2.projectPoints(
        points, C.rotation.as_rotvec(), C.translation, CAMERA.matrix, np.array(CAMERA.dist)
    )[0]
    down = RigidTransform.from_rotation(T_board.rotation)
    stood = []
    for k in outermost(points):
        place = RigidTransform.from_translation(T_board.apply(points[k] - [0.0, 0.0, STAND_OFF_M]))
        pose = to_pose6(place * down * FOLDED).tolist()
        stood.append({"corner": k, "q": q, "T_base_flange": pose})
    lens = {"width": CAMERA.width, "height": CAMERA.height, "K": list(CAMERA.K), "dist": list(CAMERA.dist)}
    data = {
        "schema": "cellward.touch-test/1",
        "job": {"target": "board", "look_pose": "look", "stand_off_m": STAND_OFF_M},
        "robot": {"model": "ur10e"},
        "arm_rms_m": 1e-5,
        "target": board,
        "T_flange_camera": [0.0] * 6,
        "hand_eye_cov": np.diag([5e-5**2] * 3 + [5e-5**2] * 3).tolist(),
        "tool": TIP.tolist(),
        "tool_reference": TIP.tolist(),
        "look": {
            "q": q,
            "T_base_flange": to_pose6(camera).tolist(),
            "ids": list(range(len(points))),
            "corners": uv.reshape(-1, 2).tolist(),
            "frames": 5,
            "camera": lens,
            **look,
        },
        "stood": stood,
    }
    (folder / "touch-test.json").write_text(json.dumps(data), "utf-8")
    return solve_touch_test(folder)


def test_a_small_print_that_the_hand_eye_found_is_not_called_off(tmp_path: Path) -> None:
    found = judged(tmp_path, printed=FOUND).as_json()
    assert (found["verdict"], found["reasons"]) == ("pass", [])
    assert found["result"]["shift_m"] < 2e-5
    assert found["result"]["turn_rad"] < 2e-5
    causes = {cause["source"]: cause["sigma_m"] for cause in found["uncertainty"]["by_source"]}
    # 1e-4 of half a metre along the camera's axis, over three axes.
    assert causes["board"] == pytest.approx(5e-5 / np.sqrt(3.0), rel=0.3)


def test_a_print_of_unknown_size_is_in_the_uncertainty(tmp_path: Path) -> None:
    found = judged(tmp_path).as_json()
    assert (found["verdict"], found["reasons"]) == ("pass", [])
    assert found["result"]["shift_m"] == pytest.approx(0.002 * 0.5, rel=0.1)
    assert found["result"]["shift_m"] < found["uncertainty"]["shift_95_m"]
    assert found["uncertainty"]["by_source"][0]["source"] == "board"


def test_causes_that_are_as_large_as_each_other_are_always_told_in_the_same_order(tmp_path: Path) -> None:
    """The tool's point and the hand are known to 0.1 mm each, and rounding would tell which comes first."""
    for tenths in range(300, 310):
        found = judged(tmp_path, {**BOARD, "square_m": tenths * 1e-4}).as_json()
        causes = [cause["source"] for cause in found["uncertainty"]["by_source"]]
        assert causes.index("point over a corner") + 1 == causes.index("tool"), tenths


def test_a_print_that_was_measured_and_is_small_all_the_same_is_called_off(tmp_path: Path) -> None:
    sure = {**BOARD, "scale_sigma": 1e-4}
    found = judged(tmp_path, sure)
    assert found.verdict == "fail"
    assert found.reasons[0].startswith("off: ")


def test_the_size_is_of_the_board_that_the_hand_eye_saw_and_of_no_other() -> None:
    other = {**BOARD, "square_m": 0.025}
    stated = {HAND_EYE: {"target": BOARD, "target_scale": FOUND}}

    def size(targets: dict[str, Any], uncertainty: dict[str, Any] = stated) -> object:
        return found_size(RunValues(robot={}, targets=targets, uncertainty=uncertainty), HAND_EYE, "board")

    assert size({"board": BOARD, "other": other}) == FOUND
    assert size({"board": other, "other": BOARD}) is None, "another board"
    assert size({"board": BOARD, "spare": dict(BOARD)}) is None, "either of two"
    assert size({"board": BOARD}, {HAND_EYE: {"target_scale": FOUND}}) is None, "not said which"
    assert size({"board": BOARD}, {}) is None


def test_a_turn_that_is_open_about_one_axis_has_a_limit_that_95_of_100_stay_below(tmp_path: Path) -> None:
    """Four corners of a narrow strip tell its turn about its length much worse than the others."""
    found = judged(tmp_path, {**BOARD, "rows": 3, "columns": 14}, printed=FOUND).as_json()["uncertainty"]
    cov = np.array(found["cov"])
    sigma = np.sqrt(np.linalg.eigvalsh(cov[3:, 3:]))
    assert sigma[2] > 3.0 * sigma[1]
    draws = np.random.default_rng(5).multivariate_normal(np.zeros(6), cov, 20_000)
    for part, limit in ((slice(0, 3), found["shift_95_m"]), (slice(3, 6), found["turn_95_rad"])):
        inside = np.mean(np.linalg.norm(draws[:, part], axis=1) < limit)
        assert inside == pytest.approx(0.95, abs=0.01)
