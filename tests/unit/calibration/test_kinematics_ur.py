"""UR arms against an independent library, published numbers and a real controller's own answers."""

import csv
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.kinematics import UR_MODELS, DhDeltas, UrArmModel, measured_arm, robot_from_spec
from calibration.kinematics.families import arm_spec, chain_document
from cell.arm_model import ArmModel
from cell.errors import CellError
from cell.formats.robot import parse_robot
from cell.poses import Array, log_xi
from tests.kit.ur_reference import independent_poses, models_of_the_library

angles = st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6).map(np.array)


def factory_deltas(scale: float = 1.0) -> DhDeltas:
    """A typical factory calibration: sub-millimetre, except along the two parallel axes."""
    return DhDeltas(
        delta_theta=scale
        * np.array([1e-7, -0.2319237455, 6.5022221386 - 2 * np.pi, 0.0128800873, -7e-8, -7e-7]),
        delta_d=scale * np.array([2.3e-4, -204.0771054, 203.3923236, 0.6852734487, -1.25e-4, -1.3e-4]),
        delta_a=scale * np.array([1.4e-4, 0.0111645466, -7.3e-5, 1.9e-4, 1.5e-6, 0.0]),
        delta_alpha=scale * np.array([2.6e-4, 4.78915e-4, 0.0073808844, 2.5e-4, 1.8e-3, 0.0]),
    )


def as_robot(deltas: DhDeltas) -> dict[str, Any]:
    return {"model": "ur5e", "calibration": {key: row.tolist() for key, row in vars(deltas).items()}}


def tracked() -> dict[str, Any]:
    """The same arm as a tracker finds it: near frames with a turn of near-parallel axes, and a little off."""
    chain = arm_spec(parse_robot(as_robot(factory_deltas()), "robot")).arm.base
    chain = replace(chain, theta=chain.theta + 4e-4, beta=chain.beta + 3e-4, a=chain.a + 2e-4)
    return {"family": "serial", **chain_document(chain, {1, 2})}


@pytest.fixture(params=["nominal", "calibrated", "measured"])
def subject(request: pytest.FixtureRequest) -> ArmModel:
    if request.param == "measured":
        return measured_arm({"model": "ur5e"}, tracked())
    return UrArmModel("ur5e", factory_deltas() if request.param == "calibrated" else None)


@pytest.mark.parametrize("name", models_of_the_library())
def test_every_nominal_arm_agrees_with_an_independent_library(name: str) -> None:
    Q, expected = independent_poses(name)
    np.testing.assert_allclose(UrArmModel(name).forward_many(Q).as_matrix(), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "reach_m"), [("ur10e", 1.3), ("ur20", 1.75), ("ur8long", 1.75), ("ur15", 1.3), ("ur18", 0.95)]
)
def test_an_arm_that_no_library_has_reaches_as_far_as_its_data_sheet_says(name: str, reach_m: float) -> None:
    model = UR_MODELS[name]
    assert abs(model.a2) + abs(model.a3) + model.d6 == pytest.approx(reach_m, abs=0.01)


def test_the_stretched_arm_has_the_published_reach() -> None:
    T = UrArmModel("ur5e").forward(np.zeros(6))
    np.testing.assert_allclose(
        T.translation, [-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997], atol=1e-12
    )


def _numbers(text: str, key: str) -> list[float]:
    found = re.search(rf"{key} = \[(.*?)\]", text)
    assert found is not None
    return [float(v) for v in found.group(1).split(",")]


@pytest.mark.data
def test_a_factory_calibration_reproduces_what_a_real_controller_reports(data_folder: Path) -> None:
    folder = data_folder / "ur5_controller_fk"
    if not folder.is_dir():
        pytest.skip(f"no controller data at {folder}")
    text = (folder / "calibration.conf").read_text("utf-8")
    keys = ("delta_theta", "delta_d", "delta_a", "delta_alpha")
    arm = robot_from_spec({"model": "ur5e", "calibration": {key: _numbers(text, key) for key in keys}})
    with (folder / "joint-eef-data.csv").open(encoding="utf-8") as file:
        rows = np.array([[float(v) for v in row] for row in list(csv.reader(file))[1:] if row])
    Q, p_mm = np.radians(rows[:, :6]), rows[:, 6:9]
    miss_mm = np.linalg.norm(1e3 * arm.forward_many(Q).translation - p_mm, axis=1)
    assert np.sqrt(np.mean(miss_mm**2)) < 0.05
    assert np.max(miss_mm) < 0.09
    nominal_mm = np.linalg.norm(1e3 * UrArmModel("ur5e").forward_many(Q).translation - p_mm, axis=1)
    assert np.sqrt(np.mean(nominal_mm**2)) > 1.0, "the deltas must be what brings the agreement"


@pytest.mark.parametrize("seed", range(5))
def test_the_jacobian_agrees_with_finite_differences(subject: ArmModel, seed: int) -> None:
    q = np.random.default_rng(seed).uniform(-3, 3, 6)
    step = 1e-6
    numeric = np.empty((6, 6))
    for i in range(6):
        dq = np.zeros(6)
        dq[i] = step
        ahead, behind = subject.forward(q + dq), subject.forward(q - dq)
        numeric[:3, i] = (ahead.translation - behind.translation) / (2 * step)
        numeric[3:, i] = (ahead.rotation * behind.rotation.inv()).as_rotvec() / (2 * step)
    np.testing.assert_allclose(subject.jacobian(q), numeric, atol=2e-7)


@settings(max_examples=60, deadline=None)
@given(angles, st.booleans())
def test_every_inverse_solution_reaches_the_pose(q: Array, calibrated: bool) -> None:
    subject = UrArmModel("ur10e", factory_deltas() if calibrated else None)
    T = subject.forward(q)
    near = subject.inverse(T, q)
    assert near is not None
    for solution in [near, *subject.inverse_all(T)]:
        assert np.max(np.abs(log_xi(subject.forward(solution).inv() * T))) < 1e-9
        assert np.all(solution >= subject.joint_limits[:, 0])
        assert np.all(solution <= subject.joint_limits[:, 1])


def test_the_inverse_stays_with_its_hint(subject: ArmModel) -> None:
    rng = np.random.default_rng(7)
    for _ in range(40):
        q = rng.uniform(-3, 3, 6)
        q[4] = np.sign(q[4]) * (0.4 + 0.8 * abs(q[4]) / 3)
        q[2] = np.sign(q[2]) * (0.4 + 0.8 * abs(q[2]) / 3)
        found = subject.inverse(subject.forward(q), q + rng.normal(0, 0.01, 6))
        assert found is not None
        np.testing.assert_allclose(found, q, atol=1e-6)


def test_the_inverse_finds_eight_branches_in_the_open(subject: ArmModel) -> None:
    q = np.array([0.3, -1.2, 1.4, -1.7, -1.5, 0.2])
    branches = subject.inverse_all(subject.forward(q))
    assert len(branches) == 8
    assert min(float(np.max(np.abs(b - q))) for b in branches) < 1e-9


def test_the_inverse_takes_the_turn_closest_to_its_hint(subject: ArmModel) -> None:
    q = np.array([0.3, -1.2, 1.4, -1.7, -1.5, 0.2])
    turns = 2 * np.pi * np.array([-1, 0, 0, 1, 1, -1])
    found = subject.inverse(subject.forward(q), q + turns + 0.3)
    assert found is not None
    np.testing.assert_allclose(found, q + turns, atol=1e-6)


def test_the_inverse_at_a_wrist_singularity_keeps_the_hinted_wrist(subject: ArmModel) -> None:
    q = np.array([0.3, -1.2, 1.4, -1.7, 0.0, 1.1])
    found = subject.inverse(subject.forward(q), q)
    assert found is not None
    np.testing.assert_allclose(found, q, atol=1e-6)


def test_a_pose_out_of_reach_has_no_solution(subject: ArmModel) -> None:
    q = np.array([0.3, -1.2, 1.4, -1.7, -1.5, 0.2])
    far = subject.forward(q).as_matrix()
    far[:3, 3] *= 5.0
    T = type(subject.forward(q)).from_matrix(far)
    assert subject.inverse(T, q) is None
    assert subject.inverse_all(T) == []


def test_the_links_join_from_the_base_to_the_flange_although_the_frames_lie_far_away(
    subject: ArmModel,
) -> None:
    q = np.array([0.3, -1.2, 1.4, -1.7, -1.5, 0.2])
    capsules = subject.capsules(q)
    assert [c.name for c in capsules] == [s.name for s in subject.links]
    np.testing.assert_array_equal(capsules[0].p0, np.zeros(3))
    for before, after in pairwise(capsules):
        np.testing.assert_array_equal(before.p1, after.p0)
    np.testing.assert_allclose(capsules[-1].p1, subject.forward(q).translation, atol=0.005)


def test_no_point_of_the_arm_is_farther_from_an_axis_than_its_reach(subject: ArmModel) -> None:
    Q = np.random.default_rng(3).uniform(-3, 3, (300, 6))
    frames = UrArmModel("ur5e").chain.frames(Q)
    ends = UrArmModel("ur5e").link_ends(Q).reshape(len(Q), -1, 3)
    for joint in range(5):
        beyond = ends[:, 2 * next(i for i, s in enumerate(subject.links) if s.joints_before > joint) :]
        arm = beyond - frames[:, joint, None, :3, 3]
        away = np.linalg.norm(np.cross(arm, frames[:, joint, None, :3, 2]), axis=-1)
        assert np.max(away) <= subject.reach_after[joint] + 1e-9


def test_a_robot_table_gives_the_calibrated_arm() -> None:
    deltas = factory_deltas()
    spec = {"model": "ur10e", "calibration": {name: list(row) for name, row in vars(deltas).items()}}
    subject: ArmModel = robot_from_spec(spec)
    q = np.array([0.1, -1.0, 1.0, -1.0, -1.0, 0.5])
    np.testing.assert_array_equal(
        subject.forward(q).as_matrix(), UrArmModel("ur10e", deltas).forward(q).as_matrix()
    )
    assert subject.name == "ur10e"


@pytest.mark.parametrize(
    ("spec", "needle"),
    [
        ({}, "supported are ur3"),
        ({"model": "ur9"}, "'ur9' is not supported"),
        ({"model": ["ur10e"]}, "is not supported"),
        ({"family": "serial", "links": []}, "'serial' cannot be moved"),
        ({"model": "ur10e", "colour": 1}, "unknown key 'colour'"),
        ({"model": "ur10e", "calibration": {"delta_q": [0] * 6}}, "unknown key 'delta_q'"),
        ({"model": "ur10e", "calibration": [1]}, "need a table"),
        ({"model": "ur10e", "calibration": {"delta_d": [0] * 5}}, "delta_d: need 6"),
        ({"model": "ur10e", "calibration": {"delta_d": [0, 0, 0, 0, 0, "x"]}}, "delta_d: need 6"),
        ({"model": "ur10e", "calibration": {"delta_a": [0, 0, 0, 0, 0, float("nan")]}}, "delta_a: need 6"),
    ],
)
def test_a_wrong_robot_table_is_refused_with_the_field_named(spec: dict[str, object], needle: str) -> None:
    with pytest.raises(CellError) as caught:
        robot_from_spec(spec)
    assert caught.value.name == "DATA_INVALID"
    assert needle in str(caught.value)


def test_a_measured_arm_is_the_chain_that_was_found_and_its_metal_stays_as_drawn() -> None:
    subject, drawn = measured_arm({"model": "ur5e"}, tracked()), UrArmModel("ur5e")
    Q = np.random.default_rng(3).uniform(-3.0, 3.0, (30, 6))
    found = arm_spec(parse_robot(tracked(), "robot")).arm.base.flange(Q)
    np.testing.assert_allclose(subject.forward_many(Q).as_matrix(), found, atol=1e-12)
    np.testing.assert_array_equal(subject.link_ends(Q), drawn.link_ends(Q))
    assert np.abs(found[:, :3, 3] - drawn.forward_many(Q).translation).max() > 5e-4


def test_far_frames_and_near_frames_are_one_arm() -> None:
    far = UrArmModel("ur5e", factory_deltas())
    near = measured_arm({"model": "ur5e"}, as_robot(factory_deltas()))
    Q = np.random.default_rng(3).uniform(-3.0, 3.0, (30, 6))
    np.testing.assert_allclose(near.forward_many(Q).as_matrix(), far.forward_many(Q).as_matrix(), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {
                "coupling": [[1.0 if i == j else 0.0 for j in range(6)] for i in range(5)]
                + [[0, 0, 0, 0, 0.2, 1]]
            },
            "six joints, each with its own link",
        ),
        (
            {"links": [{"theta": 0.0, "d": 0.1, "a": 0.2, "alpha": 0.0, "joint": "revolute"}] * 6},
            "off that of a ur5e, so it is another arm",
        ),
        (
            {"links": [{"theta": 0.0, "d": 0.1, "a": 0.2, "alpha": 0.0, "joint": "revolute"}] * 5},
            "six joints, each with its own link",
        ),
    ],
)
def test_a_chain_that_cannot_be_this_arm_is_refused(change: dict[str, Any], told: str) -> None:
    with pytest.raises(CellError, match=told) as caught:
        measured_arm({"model": "ur5e"}, {**tracked(), **change})
    assert caught.value.name == "DATA_INVALID"


def test_an_arm_with_narrower_ranges_finds_joints_within_them_alone() -> None:
    whole, ranges = UrArmModel("ur10e"), np.tile([-6.0, 6.0], (6, 1))
    ranges[0], ranges[2] = [-0.5, 0.5], [0.0, 3.5]  # the elbow's end stays that of the arm
    subject = whole.narrowed(ranges)
    assert subject.joint_limits[0].tolist() == [-0.5, 0.5]
    assert subject.joint_limits[2].tolist() == [0.0, np.pi]
    assert whole.joint_limits[0].tolist() == [-2.0 * np.pi, 2.0 * np.pi], "that one is as it was"
    q = np.array([0.2, -1.2, 1.4, -1.8, -1.5, 0.3])
    found = subject.inverse_all(whole.forward(q))
    assert found
    assert len(found) < len(whole.inverse_all(whole.forward(q)))
    assert all(np.all((ranges[:, 0] <= one) & (one <= ranges[:, 1])) for one in found)
    outside = whole.forward(q + np.array([0.6, 0, 0, 0, 0, 0]))
    assert subject.inverse(outside, q) is None


@pytest.mark.parametrize(
    "make", [robot_from_spec, lambda spec, ranges: measured_arm(spec, tracked(), ranges)]
)
def test_ranges_go_with_every_way_to_an_arm(make: Any) -> None:
    ranges = [[-1.0, 1.0]] * 6
    assert make({"model": "ur5e"}, ranges).joint_limits.tolist() == ranges
    with pytest.raises(
        CellError, match=r"'elbow' from 3\.5 to 4 rad has nothing in common with .* controller"
    ):
        make({"model": "ur5e"}, [[-1.0, 1.0], [-1.0, 1.0], [3.5, 4.0], *ranges[:3]])
