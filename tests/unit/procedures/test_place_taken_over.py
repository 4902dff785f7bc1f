"""The target's place on the flange, taken over from a capture: what is told of it, and what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import InputError
from cell.poses import exp_xi, from_pose6, log_xi
from procedures.documents import read_result
from procedures.eye_to_hand.solve.data import load_axbc
from procedures.eye_to_hand.taken_over import covering, taken_over

STORED = Path(__file__).parents[2] / "kit" / "stored_results"
FIXED = "hand-eye-05"  # a fixed camera, two placements
LARGE = 1e4  # times the covariance, so that nothing else matters


def stored(name: str = FIXED) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((STORED / f"{name}.json").read_text())
    if name == FIXED:
        document["uncertainty"]["covers"] = ["arm", "gears", "sag", "lens", "target"]
    return document


@pytest.fixture
def targets() -> dict[str, dict[str, Any]]:
    board: dict[str, Any] = stored()["inputs"]["target"]
    return {"small": {**board, "square_m": 0.02}, "board": board}


def test_the_place_is_that_of_the_last_placement_unless_one_is_named(
    targets: dict[str, dict[str, Any]],
) -> None:
    result = stored()
    for asked, label in ((None, "1"), ("0", "0")):
        found = taken_over(read_result(result), targets, "board", asked)
        there = from_pose6(result["result"]["T_flange_target"][label])
        assert (found.placement, found.target) == (label, "board")
        np.testing.assert_allclose(log_xi(there * from_pose6(found.T_marker_flange)), 0.0, atol=1e-12)


def test_the_two_sigmas_state_no_less_than_the_capture_in_any_direction(
    targets: dict[str, dict[str, Any]],
) -> None:
    rng, result = np.random.default_rng(5), stored()
    cov = LARGE * np.array(result["uncertainty"]["cov_targets"]["1"])
    result["uncertainty"]["cov_targets"]["1"] = cov.tolist()
    found = taken_over(read_result(result), targets, None, None)
    target, C = from_pose6(result["result"]["T_flange_target"]["1"]), from_pose6(found.T_marker_flange)
    drawn = rng.multivariate_normal(np.zeros(6), cov, size=2000)
    off = np.array([log_xi(C.inv() * (target * exp_xi(xi)).inv()) for xi in drawn])
    units = off / np.repeat([found.sigma_t_m, found.sigma_r_rad], 3)
    largest = np.linalg.eigvalsh(units.T @ units / len(units))[-1]
    assert 0.9 < largest < 1.1  # no less, and hardly more in the worst one


def test_the_last_link_is_in_what_is_stated(targets: dict[str, dict[str, Any]]) -> None:
    result = stored()
    result["uncertainty"]["cov_targets"]["1"] = (1e-18 * np.eye(6)).tolist()
    usual = taken_over(read_result(result), targets, None, None)
    result["result"]["scale"] = {"geometry": 2.0, "sag": 0.5}
    worse = taken_over(read_result(result), targets, None, None)
    assert usual.sigma_t_m == pytest.approx(2e-4, rel=0.01)
    assert worse.sigma_t_m == pytest.approx(4e-4, rel=0.01)


def test_correlation_is_paid_for() -> None:
    cov = np.eye(6)
    cov[0, 4] = cov[4, 0] = 0.9
    assert covering(cov) == pytest.approx((1.9**0.5, 1.9**0.5))


@pytest.mark.parametrize(
    ("name", "asked", "told"),
    [
        ("hand-eye-01", {}, "the camera of this capture was on the flange"),
        ("axbc-01", {}, "a result of the eye-to-hand check itself"),
        ("iso9283-01", {}, "no hand-eye result with an answer but one of iso9283"),
        (FIXED, {"placement": "7"}, "there is no placement 7; there is 0, 1"),
        (FIXED, {"job_target": "small"}, "saw target 'board', and the check is configured for 'small'"),
        (FIXED, {"targets": {}}, "a target that is no [target.NAME] section as it stands"),
    ],
)
def test_what_holds_no_place_for_the_check_is_refused_in_words(
    targets: dict[str, dict[str, Any]], name: str, asked: dict[str, Any], told: str
) -> None:
    words = {"targets": targets, "job_target": None, "placement": None, **asked}
    with pytest.raises(InputError) as caught:
        taken_over(read_result(stored(name)), **words)
    assert told in str(caught.value)


def test_a_covariance_of_noise_alone_is_refused(targets: dict[str, dict[str, Any]]) -> None:
    result = stored()
    del result["uncertainty"]["covers"]
    with pytest.raises(InputError, match="by method ml, covers noise alone"):
        taken_over(read_result(result), targets, None, None)


def test_a_data_set_says_what_a_place_that_was_taken_over_cannot_judge(tmp_path: Path) -> None:
    document = {
        "schema": "cellward.axbc/1",
        "T_marker_flange": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
        "sigma_C": {"t": 1e-4, "r": 3e-4},
        "X_measured_T_camera_base": [0.0] * 6,
        "observations": [{"T_base_flange": [0.0] * 6, "T_camera_marker": [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]}],
    }
    told = {}
    for source in ("drawing", "hand-eye"):
        (tmp_path / "axbc.json").write_text(json.dumps(document | {"C_from": source}))
        told[source] = load_axbc(tmp_path).known["C"]
    assert told["drawing"] == "sigma_C (0.1 mm, 0.3 mrad)"
    assert told["hand-eye"].startswith("sigma_C (0.1 mm, 0.3 mrad), taken over from a hand-eye capture: ")
    assert told["hand-eye"].endswith("is not judged, only what has changed since")


def test_a_failed_capture_is_refused(targets: dict[str, dict[str, Any]]) -> None:
    result = stored() | {"verdict": "fail", "reasons": ["the board slipped"]}
    with pytest.raises(InputError, match="this capture failed: the board slipped"):
        taken_over(read_result(result), targets, None, None)
