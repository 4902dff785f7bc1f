"""The world: true poses as functions of time, and the truth that results are judged against."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from cell.poses import from_pose6, log_xi, to_pose6
from fakes.world.scenario import Scenario
from fakes.world.world import World

Edit = Callable[[dict], None]


def world(edit: Edit = lambda raw: None, name: str = "hand_eye:ideal") -> World:
    raw = Scenario.load(name).model_dump(by_alias=True)
    edit(raw["world"])
    return World.from_scenario(Scenario.model_validate(raw), 0.0)


@pytest.fixture
def subject() -> World:
    return world()


def deviation(world: World, t: float) -> np.ndarray:
    return log_xi(world.believed_flange(t).inv() * world.true_flange(t))


def test_the_scene_closes_the_loop_base_flange_camera_target(subject: World) -> None:
    scene = subject.scene(1.0)
    assert scene.T_base_target is not None
    assert scene.T_camera_target is not None
    X = from_pose6(subject.truth()["T_flange_camera"])
    closed = scene.T_base_flange * X * scene.T_camera_target
    assert np.allclose(to_pose6(closed), subject.truth()["T_base_target"][0], atol=1e-9)


def test_with_a_fixed_camera_the_board_rides_on_the_flange() -> None:
    subject = world(name="hand_eye_to_hand:ideal")
    before = subject.scene(0.0)
    end = subject.track.start_joint_move(0.0, subject.track.at(0.0)[0] + 0.2, 1.0, 2.0)
    after = subject.scene(end)
    assert np.allclose(to_pose6(before.T_base_camera), to_pose6(after.T_base_camera))
    assert after.T_base_target is not None
    assert after.T_camera_target is not None
    seen = after.T_base_camera * after.T_camera_target
    assert np.allclose(to_pose6(seen), to_pose6(after.T_base_target), atol=1e-9)
    mounted = after.T_base_flange.inv() * after.T_base_target
    assert np.allclose(to_pose6(mounted), subject.truth()["T_flange_target"][0], atol=1e-9)


def test_each_standstill_has_a_deviation_of_its_own_of_the_size_in_the_scenario(subject: World) -> None:
    t, seen = 0.0, []
    q = subject.track.at(0.0)[0]
    for k in range(200):
        t = subject.track.start_joint_move(t + 0.2, q + 0.02 * (k % 2), 1.0, 5.0) + 0.1
        assert np.allclose(deviation(subject, t), deviation(subject, t + 0.05), atol=1e-12)
        seen.append(deviation(subject, t)[:3])
    # 600 draws: the sample deviation is within 4 * 1/sqrt(1200) of the true one.
    assert np.std(seen) == pytest.approx(1.39e-5, rel=0.12)
    assert len({tuple(np.round(s, 12)) for s in seen}) == 200


def test_the_deviation_does_not_jump_while_the_arm_moves(subject: World) -> None:
    end = subject.track.start_joint_move(1.0, subject.track.at(0.0)[0] + 0.1, 1.0, 2.0)
    times = np.linspace(0.9, end + 0.1, 400)
    steps = np.diff([deviation(subject, t) for t in times], axis=0)
    assert np.max(np.abs(steps)) < 2e-6


def test_the_same_seed_gives_the_same_world_and_another_seed_another(subject: World) -> None:
    other = world(lambda raw: raw.update(seed=7))
    assert np.array_equal(deviation(subject, 1.0), deviation(world(), 1.0))
    assert not np.allclose(deviation(subject, 1.0), deviation(other, 1.0), atol=1e-9)


def test_without_errors_belief_and_truth_are_equal() -> None:
    subject = world(lambda raw: raw["arm"].update(repeatability_t_m=0.0))
    assert np.max(np.abs(deviation(subject, 0.0))) < 1e-12


def test_factory_deltas_are_believed_and_errors_are_not() -> None:
    def off(raw: dict) -> None:
        raw["arm"]["repeatability_t_m"] = 0.0
        raw["arm"]["factory"]["delta_a"] = [0, 1e-3, 0, 0, 0, 0]
        raw["arm"]["error"]["delta_a"] = [0, 0, 2e-3, 0, 0, 0]

    subject, plain = world(off), world()
    believed = subject.believed_flange(0.0).translation - plain.believed_flange(0.0).translation
    assert np.linalg.norm(believed) == pytest.approx(1e-3, rel=1e-6)
    assert np.linalg.norm(deviation(subject, 0.0)[:3]) == pytest.approx(2e-3, rel=1e-6)


def test_the_operator_moves_the_board_at_a_moment_in_time(subject: World) -> None:
    subject.operator.confirm(1, 10.0)
    assert subject.scene(9.999).placement == 0
    assert subject.scene(10.0).placement == 1
    assert subject.operator.move_on(20.0) == 2
    assert subject.operator.move_on(30.0) == 0
    subject.operator.remove(40.0)
    assert subject.scene(40.0).T_camera_target is None
    assert subject.scene(35.0).placement == 0
    subject.operator.put_back(41.0)
    assert subject.scene(41.0).placement == 0


def test_a_placement_that_does_not_exist_is_refused(subject: World) -> None:
    with pytest.raises(ValueError, match="placement 3"):
        subject.operator.confirm(3, 1.0)


def test_an_obstacle_pushes_the_tip_back_in_proportion_to_the_depth() -> None:
    free = world()
    tool = from_pose6([0, 0, 0.18, 0, 0, 0])
    tip = (free.true_flange(0.0) * tool).translation

    def wall(raw: dict) -> None:
        point = (tip + np.array([0, 0, 0.001])).tolist()
        raw["obstacle"] = [{"point": point, "normal": [0, 0, 2.0], "stiffness_n_m": 1e4}]

    assert np.allclose(world(wall).contact_force(0.0, tool), [0, 0, 10.0, 0, 0, 0], atol=1e-6)
    assert not np.any(free.contact_force(0.0, tool))


def test_the_truth_is_plain_json_and_names_every_true_value(subject: World) -> None:
    truth = json.loads(json.dumps(subject.truth(), allow_nan=False))
    assert len(truth["T_base_target"]) == 3
    assert truth["camera"]["K"] == list(subject.intrinsics.K)
    assert truth["noise"]["sigma_flange_t"] == 1.39e-5
