"""A six-axis arm from a file: kinematics held against published poses, the inverse against forward."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.kinematics import measured_arm, robot_from_spec
from calibration.kinematics.families import arm_spec
from cell.arm_model import ArmModel
from cell.errors import CellError
from cell.formats.robot import parse_robot

FILE = Path("docs/examples/robots/irb120.json")


@pytest.fixture
def spec() -> dict[str, Any]:
    document: dict[str, Any] = json.loads(FILE.read_text("utf-8"))
    return document


@pytest.fixture
def subject(spec: dict[str, Any]) -> ArmModel:
    return robot_from_spec(spec)


def turned(*axes: tuple[str, float]) -> Rotation:
    out = Rotation.identity()
    for axis, angle in axes:
        out = out * Rotation.from_euler(axis, angle)
    return out


def by_hand(q: np.ndarray) -> RigidTransform:
    """The maker's drawing of the arm, axis by axis: z, y, y, x, y, x, with its lengths between them."""
    parts = [
        ([0.0, 0.0, 0.0], ("z", q[0])),
        ([0.0, 0.0, 0.290], ("y", q[1])),
        ([0.0, 0.0, 0.270], ("y", q[2])),
        ([0.0, 0.0, 0.070], ("x", q[3])),
        ([0.302, 0.0, 0.0], ("y", q[4])),
        ([0.072, 0.0, 0.0], ("x", q[5])),
    ]
    out = RigidTransform.identity()
    for shift, turn in parts:
        out = out * RigidTransform.from_components(shift, turned(turn))
    return out * RigidTransform.from_rotation(turned(("y", np.pi / 2)))


def test_the_home_pose_is_the_makers(subject: ArmModel) -> None:
    """RobotStudio shows the flange of an IRB 120 at (374, 0, 630) mm, quaternion (0.7071, 0, 0.7071, 0)."""
    home = subject.forward(np.zeros(6))
    np.testing.assert_allclose(home.translation, [0.374, 0.0, 0.630], atol=1e-12)
    np.testing.assert_allclose(
        np.abs(home.rotation.as_quat(scalar_first=True)), [0.5**0.5, 0, 0.5**0.5, 0], atol=1e-12
    )


def test_the_chain_is_the_drawing_axis_by_axis(subject: ArmModel) -> None:
    rng = np.random.default_rng(1)
    for q in rng.uniform(*subject.joint_limits.T, (20, 6)):
        np.testing.assert_allclose(subject.forward(q).as_matrix(), by_hand(q).as_matrix(), atol=1e-12)


def test_every_branch_reaches_the_pose_within_the_limits_and_the_joints_are_among_them(
    subject: ArmModel,
) -> None:
    rng = np.random.default_rng(2)
    low, high = subject.joint_limits.T
    for q in rng.uniform(low, high, (15, 6)):
        pose = subject.forward(q)
        found = subject.inverse_all(pose)
        for each in found:
            assert np.all((each >= low) & (each <= high))
            np.testing.assert_allclose(subject.forward(each).as_matrix(), pose.as_matrix(), atol=1e-8)
        apart = [np.abs((each - q + np.pi) % (2 * np.pi) - np.pi).max() for each in found]
        assert min(apart) < 1e-6
        near = subject.inverse(pose, q + 0.01)
        assert near is not None
        np.testing.assert_allclose(near, q, atol=1e-6)


def test_a_pose_out_of_reach_has_no_joints(subject: ArmModel) -> None:
    far = RigidTransform.from_translation([1.2, 0.0, 0.3])
    assert subject.inverse_all(far) == []
    assert subject.inverse(far, np.zeros(6)) is None


def test_capsules_ride_on_their_joints_and_within_the_reach(subject: ArmModel) -> None:
    q = np.array([0.3, -0.4, 0.5, 0.6, -0.7, 0.8])
    turned_4 = q + 0.5 * np.eye(6)[3]
    still, moved = subject.link_ends(q[None])[0], subject.link_ends(turned_4[None])[0]
    before = [shape.joints_before for shape in subject.links]
    for k, joints in enumerate(before):
        assert np.allclose(still[k], moved[k], atol=1e-12) == (joints < 4), subject.links[k].name
    shoulder = np.array([0.0, 0.0, 0.290])
    assert np.linalg.norm(still[2:] - shoulder, axis=2).max() < subject.reach_after[1]


def test_its_parameters_can_be_calibrated_and_used(spec: dict[str, Any]) -> None:
    parameters = arm_spec(parse_robot(spec, "robot")).arm
    assert len(parameters.names) == 24 + 1, "one beta, of the two parallel axes"
    measured = {"family": "serial", "links": [dict(link) for link in spec["links"]]}
    measured["links"][1]["a"] += 0.001
    longer = measured_arm(spec, measured)
    q = np.array([0.1, 0.2, -0.3, 0.4, 0.5, 0.6])
    off = longer.forward(q).translation - robot_from_spec(spec).forward(q).translation
    assert np.linalg.norm(off) == pytest.approx(0.001, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"joint_limits": [[-1.0, 1.0]] * 5}, "joint_limits"),
        ({"joint_limits": [[1.0, -1.0]] * 6}, "joint 1: 1 is not below -1"),
        ({"joint_speeds_rad_s": [0.0] * 6}, "joint_speeds_rad_s"),
        ({"capsules": []}, "capsules"),
        ({"links": [{}] * 5}, "links"),
        ({"family": "serial7"}, "did you mean 'serial"),
    ],
)
def test_a_wrong_file_is_one_sentence_that_names_the_key(
    spec: dict[str, Any], change: dict[str, Any], told: str
) -> None:
    with pytest.raises(CellError, match=told):
        parse_robot(spec | change, "irb120.json")
