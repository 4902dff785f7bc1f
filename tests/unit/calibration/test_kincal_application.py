"""Using a calibrated arm: poses to measure, joints for wanted poses, and the forms of other programs."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.identification.application import goals_from_yaw, reach, yaw_of
from calibration.identification.exports import last_to_flange, ros_kinematics, ur_deltas, urdf
from calibration.identification.model import Targets
from calibration.identification.selection import choose_poses, source_rule
from calibration.identification.solution import identify
from calibration.identification.workspace import forecast, places
from calibration.kinematics import UrArmModel
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import arm_spec, ur_chain
from cell.formats.robot import parse_robot
from cell.poses import Array
from tests.kit.kincal_scene import joints, make_scene


def calibrated(kind: str, seed: int = 0) -> SerialChain:
    """An arm with errors everywhere."""
    model = make_scene(kind, seed, 3).problem.model
    x = model.nominal + 2e-3 * np.random.default_rng(seed).normal(size=model.size)
    return model.arm.chain(x[: len(model.arm.names)])


@pytest.mark.parametrize("kind", ["palletizer", "ur10e"])
def test_joints_for_wanted_poses_reach_them_on_the_hinted_branch(kind: str) -> None:
    chain, rng = calibrated(kind), np.random.default_rng(1)
    Q = joints(kind, rng, 40)
    found = reach(chain, chain.flange(Q), Q + rng.normal(size=Q.shape) * 0.02, Q[:0], kind == "palletizer")
    assert found.found.all()
    np.testing.assert_allclose(found.q, Q, atol=1e-6)


@pytest.mark.parametrize("kind", ["palletizer", "ur10e"])
def test_without_a_hint_the_measured_poses_lead_there(kind: str) -> None:
    chain, rng = calibrated(kind), np.random.default_rng(2)
    Q = joints(kind, rng, 10)
    goals = chain.flange(Q)
    level = kind == "palletizer"
    found = reach(chain, goals, None, joints(kind, rng, 60), level)
    assert found.found.all()
    again = chain.flange(found.q)
    np.testing.assert_allclose(again[:, :3, 3], goals[:, :3, 3], atol=1e-7)
    if level:
        np.testing.assert_allclose(np.sin((yaw_of(again) - yaw_of(goals)) / 2), 0.0, atol=1e-7)
    else:
        np.testing.assert_allclose(again, goals, atol=1e-7)


def test_a_pose_out_of_reach_has_no_joints_and_leaves_the_others_alone() -> None:
    chain, Q = calibrated("palletizer"), joints("palletizer", np.random.default_rng(3), 3)
    goals = chain.flange(Q)
    goals[1, 0, 3] += 20.0
    found = reach(chain, goals, Q, Q, True)
    assert found.found.tolist() == [True, False, True]
    assert np.all(np.isnan(found.q[1]))
    np.testing.assert_allclose(found.q[[0, 2]], Q[[0, 2]], atol=1e-6)


def test_x_y_z_and_yaw_are_a_level_pose() -> None:
    T = goals_from_yaw(np.array([[1.0, 2.0, 3.0, 0.5]]))
    np.testing.assert_allclose(yaw_of(T), [0.5])
    np.testing.assert_allclose(T[0, :3, 3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(T[0, :3, 2], [0.0, 0.0, 1.0])


LIMITS = {"palletizer": 0.80, "ur10e": 0.80}


@pytest.mark.parametrize("kind", ["palletizer", "ur10e"])
def test_thirty_chosen_poses_predict_better_than_thirty_random_ones(kind: str) -> None:
    model, rng = make_scene(kind, 0, 3).problem.model, np.random.default_rng(4)
    candidates, validation = joints(kind, rng, 500), joints(kind, rng, 150)
    low, high = candidates.min(axis=0), candidates.max(axis=0)

    def promise(Q: Array, target: Targets) -> Array:
        f = model.points(model.nominal, Q, target)
        sigma = 15e-6 + 6e-6 * np.linalg.norm(f - np.array([[3.5], [0.0], [-1.0]]), axis=0)
        inside = np.all(np.clip(Q, low, high) == Q, axis=1)
        return np.where(inside & (f[2] > 0.0), sigma, np.nan)

    none = np.zeros(500, dtype=np.int64)
    plan = choose_poses(model, model.nominal, candidates, none, promise, validation, 30)
    assert plan.q.shape == (30, candidates.shape[1])
    assert np.all(np.isfinite(promise(plan.q, plan.target)))
    assert plan.predicted_rms <= LIMITS[kind] * plan.random_rms
    again = choose_poses(model, model.nominal, candidates, none, promise, validation, 30)
    np.testing.assert_array_equal(again.q, plan.q)


def test_a_plan_that_has_too_few_possible_poses_says_so() -> None:
    model = make_scene("palletizer", 0, 3).problem.model
    Q = joints("palletizer", np.random.default_rng(5), 40)
    with pytest.raises(ValueError, match="only 0 of 40 candidate poses are possible; 30 are wanted"):
        choose_poses(
            model, model.nominal, Q, np.zeros(40, dtype=np.int64), lambda q, _: np.full(len(q), np.nan), Q, 30
        )


def test_the_sources_rule_counts_poses_and_the_steps_of_every_joint() -> None:
    steps = np.radians([16.0, -17.0, 20.0]) * np.arange(50)[:, None]
    assert source_rule(steps).kept
    assert not source_rule(steps[:49]).kept
    steps[7:, 1] += np.radians(3.0)
    found = source_rule(steps)
    assert (found.short_steps, found.kept) == (1, False)
    assert found.smallest_rad == pytest.approx(np.radians(14.0))


def test_the_forecast_is_larger_where_nobody_measured() -> None:
    scene = make_scene("ur10e", 1, 60)
    found = identify(scene.problem, {})
    near = forecast(found, places(scene.Q, 50))
    far = forecast(found, np.pi * np.random.default_rng(6).uniform(-1, 1, (50, 6)))
    assert np.median(near.error95) < np.median(far.error95)
    assert near.p.shape == (50, 3)
    assert np.all(near.q >= scene.Q.min(axis=0))
    truth = scene.truth.p_tracker(near.q, ["smr1"] * 50)
    np.testing.assert_allclose(found.registration.to_tracker(near.p.T).T, truth, atol=2e-4)


def test_the_ros_origins_are_those_of_the_makers_file_for_the_nominal_arm() -> None:
    found = ros_kinematics(ur_chain("ur10e"))
    assert list(found) == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    assert found["shoulder"]["z"] == pytest.approx(0.1807)
    assert found["upper_arm"]["roll"] == pytest.approx(np.pi / 2)
    assert found["forearm"]["x"] == pytest.approx(-0.6127)
    assert (found["wrist_1"]["x"], found["wrist_1"]["z"]) == pytest.approx((-0.57155, 0.17415))
    assert found["wrist_2"]["y"] == pytest.approx(-0.11985)
    assert found["wrist_3"]["y"] == pytest.approx(0.11655)
    assert all(abs(v) < 1e-12 for v in last_to_flange(ur_chain("ur10e")).values())


def pose_of(origin: dict[str, float]) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [origin[k] for k in ("roll", "pitch", "yaw")]).as_matrix()
    T[:3, 3] = [origin[k] for k in "xyz"]
    return T


def test_the_ros_origins_of_a_calibrated_arm_multiply_out_to_its_flange() -> None:
    chain = calibrated("ur10e")
    origins = list(ros_kinematics(chain).values())
    for q in joints("ur10e", np.random.default_rng(8), 5):
        T = np.eye(4)
        for origin, angle in zip(origins, q, strict=True):
            spin = np.eye(4)
            spin[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
            T = T @ pose_of(origin) @ spin
        np.testing.assert_allclose(T @ pose_of(last_to_flange(chain)), chain.flange(q[None])[0], atol=1e-12)


def test_ur_deltas_give_the_arm_that_is_moved_the_calibrated_kinematics() -> None:
    chain = calibrated("ur10e")
    arm = UrArmModel("ur10e", ur_deltas(chain, "ur10e"))
    Q = joints("ur10e", np.random.default_rng(9), 20)
    np.testing.assert_allclose(arm.forward_many(Q).as_matrix(), chain.flange(Q), atol=1e-10)
    assert arm.inverse(arm.forward(Q[0]), Q[0] + 0.01) == pytest.approx(Q[0], abs=1e-7)


def flange_by_urdf(text: str, motors: dict[str, float]) -> Array:
    """A small reader of URDF: joints in a row, mimics followed."""
    root = ElementTree.fromstring(text.encode())
    joints_ = {j.find("parent").get("link"): j for j in root.iter("joint")}  # type: ignore[union-attr]
    T, at = np.eye(4), "base"
    while at != "flange":
        joint = joints_[at]
        origin = joint.find("origin")
        assert origin is not None
        xyz, rpy = ([float(v) for v in str(origin.get(k)).split()] for k in ("xyz", "rpy"))
        T = T @ pose_of(dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), (*xyz, *rpy), strict=True)))
        mimic = joint.find("mimic")
        value = motors.get(str(joint.get("name")), 0.0)
        if mimic is not None:
            value = float(str(mimic.get("multiplier"))) * motors[str(mimic.get("joint"))]
        moved = np.eye(4)
        if joint.get("type") == "prismatic":
            moved[2, 3] = value
        elif joint.get("type") == "revolute":
            moved[:3, :3] = Rotation.from_rotvec([0, 0, value]).as_matrix()
        T, at = T @ moved, str(joint.find("child").get("link"))  # type: ignore[union-attr]
    return T


def test_the_urdf_of_a_palletizer_follows_its_parallelogram_by_mimicking_joints() -> None:
    chain = calibrated("palletizer")
    text = urdf(chain, "bay <3>", {"smr1": np.array([0.1, 0.0, 0.2])})
    assert "bay &lt;3&gt;" in text
    assert re.findall(r'mimic joint="(\w+)"', text) == ["joint_2", "joint_3"]
    for q in joints("palletizer", np.random.default_rng(10), 5):
        links = chain.coupling @ q
        motors = {"joint_1": links[0], "joint_2": links[1], "joint_3": links[2], "joint_5": links[4]}
        np.testing.assert_allclose(flange_by_urdf(text, motors), chain.flange(q[None])[0], atol=1e-12)


def test_the_urdf_of_a_chain_with_sliding_and_rigid_links_is_the_chain() -> None:
    robot = {
        "family": "serial",
        "links": [{"d": 0.4, "alpha": -1.2, "joint": "prismatic"}, {"a": 0.1, "joint": "fixed"}, {"a": 0.3}],
    }
    chain = arm_spec(parse_robot(robot, "robot")).arm.base
    q = np.array([0.2, -0.7])
    found = flange_by_urdf(urdf(chain, "x", {}), {"joint_1": 0.2, "joint_3": -0.7})
    np.testing.assert_allclose(found, chain.flange(q[None])[0], atol=1e-12)
