"""The classic cone method beside ours, one capture by another arm, and placements that are one place."""

import json
import time
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import InputError
from procedures.hand_eye.solve.alike import alike_warnings
from tests.kit.contradictions import Document, good
from tests.kit.solved import solve_hand_eye


@pytest.fixture(scope="module")
def capture() -> Document:
    return good(np.random.default_rng(3), joints=True, plan="small")


def solved(document: Document, folder: Path, **how: Any) -> dict[str, Any]:
    path = folder / "capture.json"
    path.write_text(json.dumps(document), "utf-8")
    result: dict[str, Any] = solve_hand_eye(path, **how)
    return result


def test_the_classic_method_gives_the_mean_of_its_own_estimates(capture: Document, tmp_path: Path) -> None:
    ours = solved(capture, tmp_path, method="ml")["result"]
    subject = solved(capture, tmp_path, method="classic")["result"]
    assert ours["neighbour_spread"] == subject["neighbour_spread"]
    np.testing.assert_allclose(subject["T_flange_camera"], subject["neighbour_spread"]["pose"], atol=1e-9)
    np.testing.assert_allclose(subject["T_flange_camera"], ours["T_flange_camera"], atol=0.02)
    assert subject["T_flange_camera"] != ours["T_flange_camera"]


def test_the_unweighted_spread_is_told_beside_ours_and_is_the_larger(
    capture: Document, tmp_path: Path
) -> None:
    answer = solved(capture, tmp_path, method="ml")["result"]
    assert answer["neighbour_spread"]["within"]["t_norm"] > answer["spread_within"]["t_norm"]


def test_the_capture_s_own_robot_changes_nothing_and_another_one_does(
    capture: Document, tmp_path: Path
) -> None:
    plain = solved(capture, tmp_path, method="ml")["result"]["T_flange_camera"]
    same = solved(capture, tmp_path, method="ml", robot=capture["robot"])["result"]["T_flange_camera"]
    longer = {"model": "ur10e", "calibration": {"delta_a": [0.0, 0.002, 0.0, 0.0, 0.0, 0.0]}}
    for key in ("delta_theta", "delta_d", "delta_alpha"):
        longer["calibration"][key] = [0.0] * 6  # type: ignore[index]
    other = solved(capture, tmp_path, method="ml", robot=longer)["result"]["T_flange_camera"]
    np.testing.assert_allclose(same, plain, atol=1e-6)
    assert np.linalg.norm(np.subtract(other, plain)) > 1e-5


def test_another_robot_needs_the_joints(capture: Document, tmp_path: Path) -> None:
    document = deepcopy(capture)
    del document["robot"], document["observations"][2]["q"]
    with pytest.raises(InputError, match="observation 2 has no q"):
        solved(document, tmp_path, method="ml", robot={"model": "ur10e"})


def test_placements_that_are_one_place_are_warned_of(capture: Document, tmp_path: Path) -> None:
    document = deepcopy(capture)
    for observation in document["observations"][12:]:
        observation["group"] = 1
    codes = [w["code"] for w in solved(document, tmp_path, method="ml")["warnings"]]
    assert "placements.alike" in codes
    assert "placements.alike" not in [w["code"] for w in solved(capture, tmp_path, method="ml")["warnings"]]


def test_many_placements_are_looked_through_without_taking_each_with_each() -> None:
    W = np.tile(np.eye(4), (1000, 1, 1))
    W[:, :3, 3] = 0.05 * np.stack(np.unravel_index(np.arange(1000), (10, 10, 10)), axis=1)
    W[900] = W[17]
    W[901, :3, :3], W[901, :3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], W[18, :3, 3]  # turned by a quarter
    began = time.process_time()
    ((code, text),) = alike_warnings(W, [f"p{k}" for k in range(1000)], "base")
    assert time.process_time() - began < 5.0  # a pair takes 0.1 ms by itself
    assert code == "placements.alike"
    assert "in placements p17 and p900: they" in text
