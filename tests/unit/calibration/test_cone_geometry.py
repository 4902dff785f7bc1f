"""The set of camera poses on a cone, and which views of a board count."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.planning import (
    ConeShape,
    EyeInHand,
    EyeToHand,
    board_centre,
    candidate_axes,
    cone_poses,
    rotation_spread,
    view_faults,
)
from cell.devices import Intrinsics
from cell.poses import Array, from_pose6, log_xi

SHAPE = ConeShape(poses=20, half_angle_rad=0.44, distance_m=0.5)
CAMERA = Intrinsics(1280, 800, (802.4, 801.7, 644.2, 396.8), (0.021, -0.043, 0.0006, -0.0004, 0.0))


def board_points() -> Array:
    """Inner corners of a 10 x 7 board with 25 mm squares."""
    x, y = np.meshgrid(np.arange(1, 10), np.arange(1, 7))
    return 0.025 * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


@pytest.fixture
def subject() -> RigidTransform:
    return cone_poses(from_pose6([0.3, -0.2, 0.1, 0.4, -0.5, 0.6]), SHAPE)


def test_every_camera_looks_at_the_apex_from_the_distance(subject: RigidTransform) -> None:
    apex = np.array([0.3, -0.2, 0.1])
    sight = apex - subject.translation
    np.testing.assert_allclose(np.linalg.norm(sight, axis=1), 0.5, atol=1e-12)
    np.testing.assert_allclose(subject.rotation.apply([0, 0, 1]), sight / 0.5, atol=1e-12)


def test_every_optical_axis_has_the_half_angle_to_the_cones_axis(subject: RigidTransform) -> None:
    axis = Rotation.from_rotvec([0.4, -0.5, 0.6]).apply([0, 0, 1])
    cosines = subject.rotation.apply([0, 0, 1]) @ axis
    np.testing.assert_allclose(cosines, np.cos(0.44), atol=1e-12)


def test_laps_after_the_first_are_steeper_and_rolled() -> None:
    shape = ConeShape(12, 0.44, 0.5, second_distance_m=0.7, laps=3, roll_rad=0.5 * np.pi, steeper_rad=0.6)
    cameras = cone_poses(from_pose6(np.zeros(6)), shape)
    angles = np.arccos(cameras.rotation.apply([0, 0, 1])[:, 2])
    np.testing.assert_allclose(angles, np.tile([0.44, 0.44, 0.6, 0.6, 0.6, 0.6], 2), atol=1e-12)
    flat = cone_poses(from_pose6(np.zeros(6)), replace(shape, roll_rad=0.0))
    rolled = (flat.rotation.inv() * cameras.rotation).as_rotvec()[:, 2]
    np.testing.assert_allclose(np.abs(rolled), np.pi / 2 * np.tile([0, 0, 1, 1, 2, 2], 2), atol=1e-12)


def test_the_roll_is_constant_and_the_adjacent_rotation_is_the_published_one(subject: RigidTransform) -> None:
    about_axis = (Rotation.from_rotvec([0.4, -0.5, 0.6]).inv() * subject.rotation).as_rotvec()
    np.testing.assert_allclose(about_axis[:, 2], 0.0, atol=1e-12)
    steps = (subject.rotation[:-1].inv() * subject.rotation[1:]).magnitude()
    small_angle = 2 * np.arcsin(np.sin(0.44) * np.sin(np.pi / 20))
    np.testing.assert_allclose(steps, small_angle, rtol=0.06)


def test_a_constant_roll_turns_about_two_axes_and_a_rigid_roll_about_one(subject: RigidTransform) -> None:
    assert rotation_spread(subject.rotation) == pytest.approx(0.44 / np.sqrt(2), rel=1e-6)
    angles = 2 * np.pi * np.arange(20) / 20
    generatrix = Rotation.from_rotvec([0.0, 0.44, 0.0])
    rigid = Rotation.from_rotvec(np.stack([0 * angles, 0 * angles, angles], axis=1)) * generatrix
    relative = (rigid[0].inv() * rigid).as_rotvec()
    assert np.linalg.matrix_rank(relative, tol=1e-9) == 1
    assert rotation_spread(Rotation.from_rotvec(np.outer(np.linspace(-1, 1, 9), [0.1, 0.2, 0.3]))) < 1e-9
    assert rotation_spread(rigid[:2]) == 0.0


def test_the_centre_is_the_middle_of_the_points() -> None:
    np.testing.assert_allclose(board_centre(board_points()), [0.125, 0.0875, 0.0])


@pytest.mark.parametrize("flipped", [False, True])
def test_every_candidate_looks_into_the_board_from_the_cameras_side(flipped: bool) -> None:
    seen = from_pose6([-0.12, -0.09, 0.5, 0.25, 0.1, 0.3])
    if flipped:  # a target whose z comes out of the board
        seen = seen * from_pose6([0, 0, 0, np.pi, 0, 0])
    axes = candidate_axes(seen, board_points())
    z_camera = seen.inv().rotation.apply([0, 0, 1])
    assert len(axes) == 12
    assert len({a.label for a in axes}) == 12
    for axis in axes:
        assert axis.T_target_cone.rotation.apply([0, 0, 1]) @ z_camera > 0.7
        np.testing.assert_allclose(axis.T_target_cone.translation, board_centre(board_points()))


def test_the_first_candidate_keeps_the_cameras_roll() -> None:
    seen = from_pose6([-0.12, -0.09, 0.5, 0.0, 0.0, 0.7])
    first = candidate_axes(seen, board_points())[0].T_target_cone
    assert (first.rotation.inv() * seen.inv().rotation).magnitude() < 1e-9


@pytest.mark.parametrize("kind", ["eye-in-hand", "eye-to-hand"])
def test_a_mounting_gives_back_the_view_it_was_asked_for(kind: str) -> None:
    X, W = from_pose6([0.0, -0.08, 0.05, 0.02, 0.1, 0.3]), from_pose6([-0.7, -0.3, 0.1, -2.0, -2.0, 0.2])
    mounting = EyeInHand(X, W) if kind == "eye-in-hand" else EyeToHand(W, X)
    views = cone_poses(from_pose6([0, 0, 0, 0.1, 0.2, 0.3]), SHAPE).inv()
    flanges = mounting.flange(views)
    assert np.max(np.abs(log_xi(mounting.view(flanges).inv() * views))) < 1e-12


@pytest.mark.parametrize("kind", ["eye-in-hand", "eye-to-hand"])
def test_a_mounting_taken_from_a_view_explains_that_view(kind: str) -> None:
    nominal, F = from_pose6([0.0, -0.08, 0.05, 0.02, 0.1, 0.3]), from_pose6([-0.6, -0.2, 0.5, 2.0, -2.0, 0.2])
    seen = from_pose6([-0.12, -0.09, 0.5, 0.25, 0.1, 0.3])
    build = EyeInHand.from_view if kind == "eye-in-hand" else EyeToHand.from_view
    mounting = build(nominal, F, seen)
    assert np.max(np.abs(log_xi(mounting.view(F).inv() * seen))) < 1e-12


def seen_at(distance: float, tilt: float = 0.0, sideways: float = 0.0) -> RigidTransform:
    """The board's centre on the optical axis at ``distance``, tilted about x and moved along x."""
    centre = from_pose6([-0.125, -0.0875, 0, 0, 0, 0])
    view = from_pose6([sideways, 0, distance, tilt, 0, 0]) * centre
    return RigidTransform.from_matrix(view.as_matrix()[None])


def test_a_board_in_the_middle_is_seen() -> None:
    assert view_faults(seen_at(0.5), board_points(), CAMERA, 40.0) == [None]


@pytest.mark.parametrize(
    ("view", "needle"),
    [
        (seen_at(-0.5), "behind the camera"),
        (seen_at(0.5, tilt=1.2), "69 degrees to its normal"),
        (seen_at(0.5, sideways=0.3), "px of the image's edge"),
        (seen_at(0.5, sideways=0.7), "far outside the image"),
        (seen_at(0.12), "px of the image's edge"),
    ],
)
def test_a_bad_view_is_named(view: RigidTransform, needle: str) -> None:
    (fault,) = view_faults(view, board_points(), CAMERA, 40.0)
    assert fault is not None
    assert needle in fault


def test_the_margin_is_measured_in_distorted_pixels() -> None:
    strong = Intrinsics(1280, 800, CAMERA.K, (-0.25, 0.05, 0.0, 0.0, 0.0))
    view = seen_at(0.5, sideways=0.22)
    pose = view.as_matrix()[0]
    rvec, _ = cv2.Rodrigues(pose[:3, :3])
    pixels, _ = cv2.projectPoints(board_points(), rvec, pose[:3, 3], strong.matrix, np.array(strong.dist))
    room = float(np.min(np.minimum(pixels, [1279, 799] - pixels)))
    assert view_faults(view, board_points(), strong, room - 0.01) == [None]
    assert view_faults(view, board_points(), strong, room + 0.01) != [None]
