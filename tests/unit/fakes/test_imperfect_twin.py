"""What the twin keeps to itself: joints that turn too far, a lens not as told, a print that is off."""

from math import cos, pi
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from cell.poses import from_pose6, log_xi
from fakes.world.arm.gauge import serving
from fakes.world.camera.printed import Printed, printed_target
from fakes.world.camera.truth import PrintTruth
from fakes.world.scenario import Scenario
from fakes.world.targets import target_points
from fakes.world.world import World
from procedures.twin_arm import actual_joints

FAR = [[-pi, pi]] * 6
BOARD = {"type": "charuco", "squares_x": 10, "squares_y": 7, "square_m": 0.025, "marker_m": 0.018}
BOARD |= {"dictionary": "DICT_5X5_100"}


def tables(**of_world: Any) -> dict[str, Any]:
    """The scenario hand_eye without noise of its standstills; ``of_world`` goes into tables of its world."""
    raw = Scenario.load("hand_eye:ideal").model_dump(by_alias=True)
    raw["world"]["arm"]["repeatability_t_m"] = 0.0
    del raw["world"]["arm"]["version"]  # that of the model
    for name, keys in of_world.items():
        raw["world"][name] = raw["world"][name] | keys
    return raw


def world(**of_world: Any) -> World:
    return World.from_scenario(Scenario.model_validate(tables(**of_world)), 0.0)


def joints(n: int = 50) -> NDArray[np.float64]:
    return np.random.default_rng(3).uniform(-pi, pi, (n, 6))


def test_gears_turn_each_joint_too_far_once_and_twice_a_turn() -> None:
    errors = world(arm={"joint_errors": {"gear_once_rad": 5e-5, "gear_twice_rad": 2e-5}}).true.errors
    assert errors is not None
    for j in range(6):
        Q = np.zeros((64, 6))
        Q[:, j] = np.linspace(0.0, 2.0 * pi, 64, endpoint=False)
        off = errors.actual(Q) - Q
        waves = np.abs(np.fft.rfft(off[:, j])) / 32.0
        assert waves[1:3] == pytest.approx([5e-5, 2e-5], rel=1e-9)
        assert waves[3:].max() < 1e-12
        assert np.ptp(np.delete(off, j, axis=1), axis=0).max() < 1e-15, "no joint feels another one's gear"


@pytest.mark.parametrize("model", ["ur10e", "ur5e", "ur3"])
@pytest.mark.parametrize("link", [0, 1, 2])
def test_a_joint_gives_way_as_the_weight_of_a_link_pulls_it(model: str, link: int) -> None:
    sag = [0.0, 0.0, 0.0]
    sag[link] = 1e-4
    errors = world(arm={"model": model, "joint_errors": {"sag_rad": sag}}).true.errors
    assert errors is not None
    for q in joints():
        # UR's elbow is a2 sin(q2) above the shoulder and its wrist a3 sin(q2 + q3) above that, both a < 0; a
        # weight turns a joint by minus the derivative of its height.
        expected = 1e-4 * (cos(q[1]) if link == 0 else cos(q[1] + q[2]))
        off = errors.actual(q) - q
        assert off[(1, 1, 2)[link]] == pytest.approx(expected, abs=1e-12)
        assert np.count_nonzero(off) == 1


def test_the_truth_lists_joint_errors_as_a_robot_does() -> None:
    cell = world(arm={"joint_errors": {"gear_once_rad": 5e-5, "gear_twice_rad": 2e-5, "sag_rad": [1e-4] * 3}})
    assert cell.true.errors is not None
    Q = joints()
    told = actual_joints(cell.truth()["robot"], Q)
    np.testing.assert_allclose(told, cell.true.errors.actual(Q), atol=1e-15)
    assert np.abs(told - Q).max() > 1e-4


def test_a_camera_tells_another_lens_than_its_pictures_have() -> None:
    told = {"focal": 0.003, "centre_px": [1.6, -1.2], "dist": [0.01, 0, 0, 0]}
    cell = world(camera={"told": told})
    fx, fy, cx, cy = cell.config.camera.K if cell.config.camera else (0.0,) * 4
    assert (fx, fy, cx, cy) == cell.intrinsics.K
    assert pytest.approx((1.003 * fx, 1.003 * fy, cx + 1.6, cy - 1.2)) == cell.told_intrinsics.K
    assert cell.told_intrinsics.dist == pytest.approx((0.031, -0.043, 0.0006, -0.0004, 0.0))
    assert cell.truth()["camera"]["K"] == [fx, fy, cx, cy]


@pytest.mark.parametrize("bow_rad", [0.0, 0.7, pi / 2])
def test_a_ray_meets_a_bowed_print_where_it_lies(bow_rad: float) -> None:
    print_ = printed_target(PrintTruth(scale_x=5e-3, scale_y=-2e-3, bow_m=2e-3, bow_rad=bow_rad), BOARD)
    design = target_points(BOARD)
    points = print_.placed(design)
    assert points[:, 0] == pytest.approx(design[:, 0] * 1.005)
    assert points[:, 1] == pytest.approx(design[:, 1] * 0.998)
    assert points[:, 2].max() == pytest.approx(2e-3)
    assert 0.0 <= points[:, 2].min() < 1e-4
    eye = np.array([0.1, 0.05, -0.4])
    rays = (points - eye) / 0.37
    np.testing.assert_allclose(print_.reach(eye, rays), 0.37, rtol=1e-12)


def test_a_flat_print_is_a_plane_for_every_ray() -> None:
    rays = np.array([[0.1, 0.2, 1.0], [0.0, 0.0, 2.0]])
    np.testing.assert_allclose(Printed().reach(np.array([0.0, 0.0, -0.5]), rays), [0.5, 0.25])


def test_what_is_the_same_in_all_poses_is_another_place_of_base_and_flange() -> None:
    plain = world()
    base = from_pose6([0.002, -0.001, 0.003, 0.001, -0.002, 0.003])
    flange = from_pose6([-0.001, 0.0, 0.002, 0.002, 0.001, 0.0])

    class Moved:
        def forward(self, q: Any) -> RigidTransform:
            return base * plain.true.forward(q) * flange

    found = serving(plain.believed, Moved(), np.array(FAR))  # type: ignore[arg-type]
    np.testing.assert_allclose(log_xi(base.inv() * found[0]), np.zeros(6), atol=1e-9)
    np.testing.assert_allclose(log_xi(flange.inv() * found[1]), np.zeros(6), atol=1e-9)


def test_the_truth_is_the_camera_that_serves_best_with_the_controllers_arm() -> None:
    cell = World.from_scenario(Scenario.load("workshop"), 0.0)
    truth = cell.truth()

    def off(place: dict[str, Any]) -> float:
        """RMS, m, of where the board's camera image is from where controller and ``place`` have it."""
        X, W = from_pose6(place["T_flange_camera"]), from_pose6(place["T_base_target"][0])
        Q = np.random.default_rng(5).uniform(-pi, pi, (500, 6))
        seen = (cell.true.forward(Q) * cell.T_mount_camera).inv() * cell.T_mount_target[0]
        return float(
            np.sqrt(np.mean(log_xi((cell.believed.forward(Q) * X).inv() * W * seen.inv())[:, :3] ** 2))
        )

    assert off(truth) < 0.9 * off(truth["mechanical"])
    moved = log_xi(from_pose6(truth["T_flange_camera"]).inv() * cell.T_mount_camera)
    assert 5e-5 < np.linalg.norm(moved[:3]) < 1e-3
    exact = world().truth()
    assert exact["T_flange_camera"] == pytest.approx(exact["mechanical"]["T_flange_camera"])


def test_a_print_without_a_target_is_refused() -> None:
    raw = Scenario.load("laser:ideal").model_dump(by_alias=True)
    raw["world"]["target_print"] = {"scale_x": 0.001}
    with pytest.raises(ValueError, match="target_print says how a target is printed"):
        Scenario.model_validate(raw)
