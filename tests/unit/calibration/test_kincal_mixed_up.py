"""Sets that look better than they are: rows twice, names exchanged, noise that nobody has, poses far away."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.identification.observability import pose_numbers
from cell.errors import InputError
from tests.kit.kincal_scene import Scene, joints, make_scene
from tests.kit.solved import solve_kincal

TOOLS = {
    "palletizer": {"smr1": (0.1, 0.05, -0.1), "smr2": (0.1, 0.02, -0.1)},
    "ur10e": {"smr1": (0.03, 0.05, 0.12), "smr2": (0.03, 0.02, 0.12)},
}


def solved(scene: Scene, folder: Path, **more: Any) -> dict[str, Any]:
    result: Any = solve_kincal(scene.write(folder), **more)
    json.dumps(result, allow_nan=False)
    return result  # type: ignore[no-any-return]


def told(result: dict[str, Any]) -> dict[str, str]:
    return {w["code"]: w["text"] for w in result["warnings"]}


def renamed(scene: Scene, rows: range) -> Scene:
    other = {"smr1": "smr2", "smr2": "smr1"}
    samples = [
        {**s, "target": other[s["target"]]} if k in rows else s for k, s in enumerate(scene.data["samples"])
    ]
    return scene.changed(samples=samples)


def test_rows_that_are_there_twice_do_not_make_the_answer_surer(tmp_path: Path) -> None:
    scene = make_scene("palletizer", 20, 40)
    once = solved(scene, tmp_path)
    twice = solved(scene.changed(samples=scene.data["samples"] * 2), tmp_path)
    assert "samples.copies" not in told(once)
    assert told(twice)["samples.copies"].startswith("40 samples repeat others")
    assert "samples.rejected" not in told(twice)
    assert twice["inputs"]["used"] == 40
    assert twice["result"]["rejected"][0] == {"index": 40, "reason": "a copy of sample 0"}
    for answer in ("uncertainty", "heldout"):
        assert twice[answer] == once[answer]


def test_copies_of_too_few_poses_are_refused_as_not_distinct(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 21, 6)
    for few in (6, 1):
        repeated = solved(scene.changed(samples=scene.data["samples"][:few] * 10), tmp_path)
        assert repeated["reasons"][0].startswith("poses-not-distinct")


def test_readings_at_one_pose_are_held_out_together() -> None:
    problem = make_scene("ur10e", 22, 4).problem
    assert pose_numbers(problem.take(np.array([2, 0, 2, 1, 0]))).tolist() == [0, 1, 0, 2, 1]


def test_a_pose_measured_again_does_not_vouch_for_itself(tmp_path: Path) -> None:
    """Its own other reading, with the same error of the joints, would make it look well predicted."""
    scene = make_scene("palletizer", 23, 12)
    rng = np.random.default_rng(23)
    off = 4e-4 * rng.normal(size=(12, 3))  # what the arm's parameters lack, the same at each visit
    again = [
        {**s, "p_tracker": (np.array(s["p_tracker"]) + off[k] + 1e-5 * rng.normal(size=3)).tolist()}
        for _ in range(4)
        for k, s in enumerate(scene.data["samples"])
    ]
    once = solved(scene.changed(samples=again[:12]), tmp_path)
    often = solved(scene.changed(samples=again), tmp_path)
    assert often["result"]["rms_calibrated"] > 0.8 * once["result"]["rms_calibrated"]


def test_of_few_poses_every_one_is_judged_by_an_arm_that_did_not_see_it(tmp_path: Path) -> None:
    """Five folds of eight poses leave six, which cannot determine a palletizer; eight of one leave seven."""
    few = solved(make_scene("palletizer", 35, 8), tmp_path)["heldout"]
    assert (few["samples"], few["folds"]) == (8, 8)
    many = solved(make_scene("palletizer", 35, 40), tmp_path)["heldout"]
    assert (many["samples"], many["folds"]) == (40, 5)


def test_a_reading_of_another_reflector_is_left_out_with_that_reflectors_name(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 24, 60, tools=TOOLS["ur10e"])
    (out,) = solved(renamed(scene, range(7, 8)), tmp_path)["result"]["rejected"]
    assert out["index"] == 7
    assert out["reason"].endswith("it fits reflector smr2 instead")
    blunder = make_scene("ur10e", 24, 60, tools=TOOLS["ur10e"], blunders=1)
    (out,) = solved(blunder, tmp_path)["result"]["rejected"]
    assert "it fits reflector" not in out["reason"]


@pytest.mark.parametrize("kind", TOOLS)
def test_reflectors_that_have_each_others_names_are_told(kind: str, tmp_path: Path) -> None:
    scene = make_scene(kind, 25, 60, tools=TOOLS[kind])
    assert "reflector.names" not in told(solved(scene, tmp_path))
    text = told(solved(renamed(scene, range(60)), tmp_path))["reflector.names"]
    assert "smr1 is where smr2 should be" in text


@pytest.mark.parametrize("method", [None, "classic"])
def test_residuals_that_no_tracker_has_are_not_passed_off_as_its_noise(
    method: str | None, tmp_path: Path
) -> None:
    scene = make_scene("palletizer", 26, 60, tools=TOOLS["palletizer"])
    half = solved(renamed(scene, range(30)), tmp_path, method=method)
    assert half["verdict"] == "warn"
    assert "reflectors are mixed up" in told(half)["noise.large"]
    good = solved(scene, tmp_path, method=method)
    assert good["verdict"] == "pass"


def test_noise_that_is_given_in_millimetres_is_doubted(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 27, 60)
    far = solved(scene.changed(noise={"sigma0": 0.015, "sigma_per_m": 0.006}), tmp_path)
    assert "is it in metres?" in told(far)["noise.too-large"]
    careful = solved(scene.changed(noise={"sigma0": 45e-6, "sigma_per_m": 18e-6}), tmp_path)
    assert told(careful) == {}


def test_the_classic_methods_noise_counts_what_the_readings_determine(tmp_path: Path) -> None:
    """Eighteen parameters and a registration, but seventeen numbers: else few poses look noisier."""
    ratios = []
    for seed in range(12):
        scene = make_scene("palletizer", 100 + seed, 16)
        tracker = solved(scene, tmp_path, method="classic")["uncertainty"]["tracker"]
        ratios.append(tracker["sigma_axis"] / (15e-6 + 6e-6 * tracker["range_m"]))
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.12)


def test_joints_and_poses_outside_of_what_was_sampled_are_told(tmp_path: Path) -> None:
    scene = make_scene("palletizer", 28, 60)
    query = tmp_path / "query.json"
    Q = joints("palletizer", np.random.default_rng(1), 3)
    Q[1, 2] = -4.0
    query.write_text(json.dumps({"schema": "cellward.kincal-query/1", "q": Q.tolist()}), "utf-8")
    text = told(solved(scene, tmp_path, predict=query))["predict.beyond-samples"]
    assert text.startswith("1 of --predict are outside the sampled ranges of joint 3")
    targets = tmp_path / "targets.json"
    rows = [[0.5, 0.2, 0.6, 0.0], [1500.0, 200.0, 900.0, 0.1]]
    targets.write_text(json.dumps({"schema": "cellward.kincal-targets/1", "targets": rows}), "utf-8")
    warned = told(solved(scene, tmp_path, targets=targets))
    assert set(warned) == {"targets.beyond-samples", "targets.unreachable", "units.translation"}


def test_a_reflector_that_no_sample_has_is_as_sure_as_its_drawing(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 33, 60, tools=TOOLS["ur10e"])
    samples = [s for s in scene.data["samples"] if s["target"] == "smr1"]
    query = tmp_path / "query.json"
    asked = {"schema": "cellward.kincal-query/1", "q": scene.Q[:5].tolist(), "target": "smr2"}
    query.write_text(json.dumps(asked), "utf-8")
    result = solved(scene.changed(samples=samples), tmp_path, predict=query)
    assert "the nominal one, to 20 mm" in told(result)["predict.unmeasured"]
    assert min(result["result"]["p_tracker_95"]) > 0.02 * 2.7  # 95 % of a round cloud of 20 mm


def test_the_predicted_error_is_that_of_the_reflector_that_is_known_worst(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 34, 60, tools=TOOLS["ur10e"])
    samples = [s for k, s in enumerate(scene.data["samples"]) if s["target"] == "smr1" or k < 5]
    found = solved(scene.changed(samples=samples), tmp_path)
    other = [{**s, "target": "smr1"} for s in samples if s["target"] == "smr1"]
    alone = solved(scene.changed(samples=other), tmp_path)
    worst, best = (r["uncertainty"]["predicted_95"]["samples"]["median"] for r in (found, alone))
    assert worst > 1.1 * best


def test_questions_in_degrees_are_told(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 29, 40)
    query, targets = tmp_path / "query.json", tmp_path / "targets.json"
    asked = {"schema": "cellward.kincal-query/1", "q": [[90.0, -90.0, 90.0, -90.0, -90.0, 0.0]]}
    query.write_text(json.dumps(asked), "utf-8")
    pose = {"schema": "cellward.kincal-targets/1", "targets": [[0.5, 0.2, 0.6, 0.0, 180.0, 0.0]]}
    targets.write_text(json.dumps(pose), "utf-8")
    assert "a joint of query.json" in told(solved(scene, tmp_path, predict=query))["units.rotation"]
    assert "an attitude of targets.json" in told(solved(scene, tmp_path, targets=targets))["units.rotation"]


def test_no_target_has_no_joints(tmp_path: Path) -> None:
    targets = tmp_path / "targets.json"
    targets.write_text(json.dumps({"schema": "cellward.kincal-targets/1", "targets": []}), "utf-8")
    assert solved(make_scene("ur10e", 30, 40), tmp_path, targets=targets)["result"]["q"] == []


@pytest.mark.parametrize("kind", ["palletizer", "ur10e"])
def test_a_robot_in_millimetres_is_refused_by_name(kind: str, tmp_path: Path) -> None:
    scene = make_scene(kind, 31, 40)
    robot = json.loads(json.dumps(scene.data["robot"]))
    if kind == "palletizer":
        robot["parameters"]["a2"] *= 1e3
    else:
        robot["tool"]["smr1"] = [1e3 * v for v in robot["tool"]["smr1"]]
    with pytest.raises(InputError, match=r"(a2|tool smr1) of the robot is longer than 20 m"):
        solved(scene.changed(robot=robot), tmp_path)


def test_the_result_says_how_well_its_noise_is_known(tmp_path: Path) -> None:
    scene = make_scene("palletizer", 33, 20)
    found = solved(scene, tmp_path)["uncertainty"]
    assert found["degrees_of_freedom"] == pytest.approx(3 * 20 - 17, abs=0.1)
    given = solved(scene.changed(noise={"sigma0": 15e-6, "sigma_per_m": 6e-6}), tmp_path)["uncertainty"]
    assert given["degrees_of_freedom"] is None
