"""What is stated of targets that were driven to beside where they truly were."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.poses import Array, from_pose6, to_pose6
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.eye_to_hand.result import DrivenTarget, DrivenTargets, SeenAtTarget
from procedures.eye_to_hand.truth import _judge_driven, driven_truth
from procedures.twin_arm import true_flange

HOME = "hand_eye_to_hand:ideal"


@pytest.fixture
def truth() -> dict[str, Any]:
    return World.from_scenario(Scenario.load(HOME)).truth()


def home() -> Array:
    return np.array(Scenario.load(HOME).cell.poses["home"], dtype=float)


def at_joints(truth: dict[str, Any], q: Array) -> RigidTransform:
    """T_camera_flange as it truly is."""
    flange = RigidTransform.from_matrix(true_flange(truth["robot"], q[None])[0])
    return from_pose6(truth["mechanical"]["T_base_camera"]).inv() * flange


def seen(q: Array, off: Array, off_95_m: float) -> SeenAtTarget:
    size = float(np.linalg.norm(off))
    return SeenAtTarget(q=q.tolist(), off_m=size, off=off.tolist(), off_95_m=off_95_m, common_95_m=off_95_m)


def driven(T_camera_flange: RigidTransform, better: bool | None, **ways: SeenAtTarget) -> DrivenTargets:
    pose = to_pose6(T_camera_flange).tolist()
    about = {"number": 1, "T_camera_flange": pose, "given": pose, "corrected": pose}
    target = DrivenTarget(**about, before=ways.get("before"), after=ways.get("after"))
    return DrivenTargets(way="model", targets=[target], better=better, meaning="", lost=[])


def test_how_an_arm_repeats_an_angle_is_allowed_for_over_the_lever(
    truth: dict[str, Any],
) -> None:
    lever_m = float(np.linalg.norm(truth["mechanical"]["T_flange_target"][0][:3]))
    assert lever_m > 0.01
    wrong_m, sigma_rad = 1e-3, 2e-3
    truth["noise"] |= {"sigma_flange_t": 0.0, "sigma_flange_r": sigma_rad}
    at_home = at_joints(truth, home())
    stated = seen(home(), np.array([wrong_m, 0.0, 0.0]), 1e-9)
    (share,) = driven_truth(driven(at_home, None, before=stated), truth).shares
    assert share == pytest.approx(wrong_m / (2.795 * sigma_rad * lever_m), rel=1e-6)


def test_a_call_that_chance_makes_wrong_is_told_and_does_not_fail_a_result(truth: dict[str, Any]) -> None:
    moved = home() + np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0])
    place = from_pose6(truth["mechanical"]["T_flange_target"][0])
    at_home = at_joints(truth, home())
    off = (at_joints(truth, moved) * place).translation - (at_home * place).translation
    ways = {"before": seen(home(), np.zeros(3), 1e-4), "after": seen(moved, off, 1e-4)}
    subject = _judge_driven(driven(at_home, True, **ways), truth)
    assert subject.good, subject.text
    assert max(subject.of95.values()) < 1e-3
    assert subject.text.endswith("corrected is called surely nearer, and truly is NOT")
    ways["after"].off[0] += 0.002
    wrong = _judge_driven(driven(at_home, True, **ways), truth)
    assert not wrong.good
    (name,) = wrong.of95
    size, unit = wrong.limits95[name]
    assert (wrong.of95[name] * size, unit) == (pytest.approx(0.002, rel=1e-3), "m")
