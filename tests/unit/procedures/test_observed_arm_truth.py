"""A calibrated palletizer beside the twin's own: that arm counts, not the one that stands beside it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.formats.result import read_as
from cell.poses import from_pose6, to_pose6
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.tracker.result import KincalResult
from procedures.tracker.truth import judge_arm
from tests.kit.whole_results import whole
from tests.unit.procedures.test_corrected_targets import SCENARIO, true_kinematics


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Data sets whose joints are all that counts."""
    samples = [
        {"q": q, "p_tracker": [1.0, 1.0, 1.0], "target": "smr1"}
        for q in np.random.default_rng(3).uniform([-2, 0.9, -2, -2], [2, 2, -0.7, 2], (20, 4)).tolist()
    ]
    for name in ("kincal.json", "heldout.json"):
        (tmp_path / name).write_text(json.dumps({"samples": samples}))
    return tmp_path


@pytest.mark.parametrize(("longer_m", "good"), [(0.0, True), (0.0003, False)])
def test_only_the_true_palletizer_keeps_its_promise(longer_m: float, good: bool, folder: Path) -> None:
    found, truth = true_kinematics(), World.from_scenario(Scenario.load(SCENARIO)).truth()
    found["robot"]["parameters"]["a2"] += longer_m
    sampling: dict[str, Any] = {"role": "observed_arm", "measured": 20, "set_aside": 4, "stored": None}
    answer = {
        "robot": found["robot"],
        "T_tracker_base": to_pose6(from_pose6(found["T_base_tracker"]).inv()).tolist(),
        "absolute_accuracy": {"predicted_95": 1e-4},
    }
    result = read_as(
        KincalResult,
        whole(
            {
                "kind": "kincal",
                "verdict": "pass",
                "result": answer,
                "inputs": {"sampling": sampling},
                "heldout": {"set_aside": {"rms": {"registration_only": 0.003}}},
            }
        ),
    )
    subject = judge_arm(result, truth, folder)
    assert subject.good is good, subject.text
    assert ("NOT" in subject.text) is not good
