"""The tool's point over points of a board: how far off it is, and which part of a cell that blames."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.hand_eye import se3
from calibration.touch import Standing, common_motion, outermost, over_points, points_off, towards_camera
from cell.poses import Array
from tests.kit.cross_check_scene import checked

POINTS = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, 0.15, 0.0], [0.0, 0.15, 0.0]])


def made(seed: int = 4) -> Standing:
    """A cell in which nothing is off."""
    rng = np.random.default_rng(seed)
    look, X = se3.exp(rng.normal(size=(2, 6)) * 0.4)
    C = np.eye(4)
    C[:3, :3], C[:3, 3] = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix(), [-0.1, -0.05, 0.5]
    tool, places = np.array([0.01, -0.02, 0.18]), over_points(POINTS, C, 0.003)
    flange = np.tile(np.eye(4), (len(POINTS), 1, 1))
    target = look @ X @ C
    for T, place in zip(flange, places, strict=True):
        T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        T[:3, 3] = (target @ [*place, 1.0])[:3] - T[:3, :3] @ tool
    return Standing(look, flange, X, C, tool, places)


def moved(of: Standing, part: str, step: Array) -> Standing:
    if part == "tool":
        return replace(of, tool=of.tool + step)
    at = {"camera": "X", "look": "flange_look", "flange": "flange"}[part]
    return replace(of, **{at: getattr(of, at) @ se3.exp(step)})


def test_points_are_on_the_side_of_the_camera_and_nothing_is_off_in_a_true_cell() -> None:
    subject = made()
    assert towards_camera(subject.C) == -1.0  # z of a board goes into it
    assert subject.places[:, 2] == pytest.approx(-0.003)
    assert points_off(subject).off == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("part", ["camera", "look", "flange", "tool"])
def test_derivatives_are_what_a_small_motion_does(part: str) -> None:
    of = made()
    subject = getattr(points_off(of), f"by_{part}")
    for axis in range(subject.shape[2]):
        step = 1e-6 * np.eye(subject.shape[2])[axis]
        there, back = (points_off(moved(of, part, sign * step)).off for sign in (1.0, -1.0))
        assert (there - back) / 2e-6 == pytest.approx(subject[:, :, axis], abs=1e-7)


def test_a_motion_of_the_target_in_the_camera_counts_as_one_of_the_camera() -> None:
    of, step = made(), np.array([1e-6, -2e-6, 1e-6, 3e-6, 1e-6, -2e-6])
    by_target = points_off(replace(of, C=se3.exp(step) @ of.C)).off
    assert by_target == pytest.approx(points_off(of).by_camera @ step, abs=1e-10)


def test_a_common_shift_and_turn_are_found_and_what_they_leave() -> None:
    shift, turn = np.array([1e-3, -2e-3, 5e-4]), np.array([1e-3, 2e-3, -3e-3])
    own = 1e-5 * np.array([[1.0, -1.0, 1.0], [-1.0, -1.0, -1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, -1.0]])
    off = shift + np.cross(turn, POINTS - POINTS.mean(axis=0)) + own
    subject = common_motion(POINTS, off)
    assert subject.shift == pytest.approx(shift, abs=1e-8)
    assert subject.turn == pytest.approx(turn, abs=2e-4)
    assert 1e-6 < np.abs(subject.left).max() < 3e-5


def test_the_outermost_corners_of_a_board_go_round_it() -> None:
    grid = np.array([[0.025 * x, 0.025 * y, 0.0] for y in range(6) for x in range(9)])
    assert outermost(grid) == [0, 8, 53, 45]


BENT_M = 2.5e-3  # a person's hand and a reference to 0.05 mm leave 0.7 mm open to doubt


def test_without_beams_the_touch_test_names_a_bent_tool_and_nothing_without_one() -> None:
    assert checked(1, "none", setup="eye-in-hand", beams=False, touch=True).part == "none"
    assert checked(1, "tool", setup="eye-in-hand", beams=False).part == "cannot-tell"
    subject = checked(1, "tool", setup="eye-in-hand", beams=False, touch=True, tool_m=BENT_M)
    assert subject.part == "tool"
    assert np.linalg.norm(subject.change) == pytest.approx(BENT_M, rel=0.3)


def test_a_moved_camera_is_named_and_not_the_tool_which_stood_beside_the_corners() -> None:
    subject = checked(3, "camera", setup="eye-in-hand", poses=100, touch=True)
    assert subject.part == "camera"
