"""Orders of the poses and setups that a data set cannot tell apart are named, others are not."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tests.kit.hand_eye_scene import POINTS, cone_views, make_scene
from tests.kit.solved import solve_hand_eye

CODE = "poses.order-unchecked"


def of_the_order(found: dict[str, Any]) -> list[str]:
    return [w["text"] for w in found["warnings"] if w["code"] == CODE]


@pytest.fixture
def subject() -> list[RigidTransform]:
    """A regular cone about the board's centre."""
    views = []
    for phi in 2 * np.pi * np.arange(12) / 12:
        R = Rotation.from_rotvec([0.44 * np.sin(phi), -0.44 * np.cos(phi), 0.0])
        views.append(RigidTransform.from_components([0, 0, 0.5] - R.apply(POINTS.mean(axis=0)), R))
    return views


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_a_regular_cone_cannot_show_a_wrong_order(
    tmp_path: Path, subject: list[RigidTransform], setup: str
) -> None:
    scene = make_scene(5, setup, count=12, views=subject)
    right = solve_hand_eye(scene.write(tmp_path))
    scene.flange[:] = [*scene.flange[1:], scene.flange[0]]
    wrong = solve_hand_eye(scene.write(tmp_path))
    spreads = [found["residuals"]["spread_mean"]["t"] for found in (right, wrong)]
    assert spreads[1] == pytest.approx(spreads[0], rel=0.5)
    for found in (right, wrong):
        (warning,) = of_the_order(found)
        assert f"the order of the poses and the setup {setup!r}" in warning


def test_poses_recorded_with_the_times_of_their_frames_are_in_order(
    tmp_path: Path, subject: list[RigidTransform]
) -> None:
    data = make_scene(5, count=12, views=subject).data_set()
    for k, observation in enumerate(data["observations"]):
        observation["t"] = 10.0 * k
        observation["frames"] = [{"corners": observation.pop("corners"), "t": 10.0 * k + 0.1}]
    (tmp_path / "capture.json").write_text(json.dumps(data))
    assert of_the_order(solve_hand_eye(tmp_path)) == []


def test_one_steep_pose_more_settles_the_order(tmp_path: Path, subject: list[RigidTransform]) -> None:
    steep = cone_views(np.random.default_rng(1), 3, 0.2)[1]
    scene = make_scene(5, count=13, views=[*subject, steep])
    assert of_the_order(solve_hand_eye(scene.write(tmp_path))) == []


def test_two_placements_settle_the_order(tmp_path: Path, subject: list[RigidTransform]) -> None:
    scene = make_scene(5, count=24, groups=2, views=[*subject, *subject])
    assert of_the_order(solve_hand_eye(scene.write(tmp_path))) == []
