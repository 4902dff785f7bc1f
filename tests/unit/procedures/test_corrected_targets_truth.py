"""What is stated of corrected targets beside where the arm truly went: a wrong figure disagrees."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.errors import CellError
from cell.formats.corrected_targets import SCHEMA
from cell.poses import from_pose6, to_pose6
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.corrected_targets.judging import solve_targets
from procedures.corrected_targets.truth import judge_targets
from procedures.twin_arm import observed_flange
from tests.unit.procedures.test_corrected_targets import SCENARIO, true_kinematics

NOISE = {"sigma0": 1.5e-5, "sigma_per_m": 6e-6}
OFF_RAD = 0.002  # of the axis of a joint, as given


@pytest.fixture
def truth() -> dict[str, Any]:
    return World.from_scenario(Scenario.load(SCENARIO)).truth()


def run_of(folder: Path, truth: dict[str, Any], reflector: str | None = "smr1") -> Path:
    """A run folder: four targets at which the arm rests truly, and 2 mrad beside as given."""
    found, rng = true_kinematics(), np.random.default_rng(3)
    stand = from_pose6(truth["tracker"]["T_base_tracker"])
    point = np.array(truth["tracker"]["reflectors"]["smr1"]["point"])
    Q = np.array(
        [[0.2, 1.5, -1.4, 0.1], [-0.4, 1.3, -1.2, 0.5], [0.6, 1.7, -1.6, -0.4], [0.0, 1.4, -1.0, 0.2]]
    )
    asked = {"given": Q + np.array([OFF_RAD, 0.0, 0.0, 0.0]), "corrected": Q}
    at = RigidTransform.from_matrix(observed_flange(truth["observed"], Q))
    targets = [
        {
            "T_base_flange": to_pose6(T).tolist(),
            "given": asked["given"][k].tolist(),
            "corrected": Q[k].tolist(),
            "command": [0.0] * 4,
        }
        for k, T in enumerate(at)
    ]
    arrivals = []
    for how, rows in asked.items():
        flanges = observed_flange(truth["observed"], rows)
        for k, T in enumerate(flanges):
            p = stand.inv().apply(T[:3, :3] @ point + T[:3, 3])
            seen = (p + NOISE["sigma0"] * rng.normal(size=3)).tolist() if reflector else None
            arrivals.append({"target": k, "how": how, "q": rows[k].tolist(), "p_tracker": seen})
    data = {
        "schema": SCHEMA,
        "arm": "palletizer",
        "robot": found["robot"],
        "predicted_95": 1e-4,
        "reflector": reflector,
        "T_base_tracker": found["T_base_tracker"] if reflector else None,
        "noise": NOISE if reflector else None,
        "as_given": True,
        "pose_tolerance_rad": 0.002,
        "targets": targets,
        "arrivals": arrivals,
    }
    (folder / "corrected-targets.json").write_text(json.dumps(data), "utf-8")
    return folder


def judged(folder: Path, truth: dict[str, Any], worse_m: float = 0.0) -> Any:
    """Of the run in ``folder``; every corrected target is stated to be ``worse_m`` further off in x."""
    found = solve_targets(folder / "corrected-targets.json", None)
    document = found.as_json()
    for target in document["result"]["targets"]:
        target["after"]["error"][0] += worse_m
    return judge_targets(type(found).model_validate(document), truth, folder)


def test_what_is_stated_agrees_with_where_the_arm_went(truth: dict[str, Any], tmp_path: Path) -> None:
    subject = judged(run_of(tmp_path, truth), truth)
    assert subject.good, subject.text
    assert "NOT" not in subject.text
    assert float(subject.off.split()[0]) < 0.08, "mm"
    assert " left +- 0." in subject.stated


def test_a_target_that_is_further_off_than_stated_disagrees(truth: dict[str, Any], tmp_path: Path) -> None:
    subject = judged(run_of(tmp_path, truth), truth, 3e-4)
    assert not subject.good
    assert "NOT consistent with what is stated" in subject.text


def test_one_of_many_targets_beyond_its_own_limit_is_no_finding(
    truth: dict[str, Any], tmp_path: Path
) -> None:
    """Of eight arrivals that each keep their 95 % the worst is beyond its own in a third of all good runs."""
    run_of(tmp_path, truth)
    found = solve_targets(tmp_path / "corrected-targets.json", None)
    target = found.result.targets[0]
    assert target.after is not None
    assert target.after.error_95_m is not None
    own, worst = np.array(target.after.error), target.after.error_95_m
    (where,) = [float(v) for v in judge_targets(found, truth, tmp_path).of95.values()]
    assert where < 1.0
    inside = []
    for share in (1.15, 1.5):
        target.after.error[2] = float(own[2]) + share * worst
        subject = judge_targets(found, truth, tmp_path)
        ((name, off),) = subject.of95.items()
        assert name == "the worst of 8 arrivals"
        size, unit = subject.limits95[name]
        assert (off * size, unit) == (pytest.approx(share * worst, rel=0.3), "m")
        inside.append(subject.inside95)
    assert inside == [True, False]


def test_an_arm_that_went_elsewhere_disagrees(truth: dict[str, Any], tmp_path: Path) -> None:
    run_of(tmp_path, truth)
    truth["observed"]["parameters"]["a2"] += 0.0005
    assert not judged(tmp_path, truth).good


def test_a_correction_that_makes_nothing_better_disagrees(truth: dict[str, Any], tmp_path: Path) -> None:
    path = run_of(tmp_path, truth) / "corrected-targets.json"
    data = json.loads(path.read_text("utf-8"))
    for arrival in data["arrivals"]:
        arrival["how"] = "corrected" if arrival["how"] == "given" else "given"
    path.write_text(json.dumps(data), "utf-8")
    subject = judged(tmp_path, truth)
    assert not subject.good
    assert "corrected targets are truly NOT closer than as given" in subject.text


def test_without_a_tracker_it_is_said_that_nothing_can_be_judged(
    truth: dict[str, Any], tmp_path: Path
) -> None:
    with pytest.raises(CellError, match="no tracker looked"):
        judged(run_of(tmp_path, truth, None), truth)


def test_the_row_is_of_corrected_targets_alone(truth: dict[str, Any], tmp_path: Path) -> None:
    """What is said to be left is that of a corrected target, and so are its limit and how far off it is."""
    true = judged(run_of(tmp_path, truth), truth)
    document = solve_targets(tmp_path / "corrected-targets.json", None)
    for target in document.result.targets:
        assert target.before is not None
        target.before.error[0] += 5e-4
    subject = judge_targets(document, truth, tmp_path)
    assert not subject.good
    assert (subject.stated, subject.off) == (true.stated, true.off)
