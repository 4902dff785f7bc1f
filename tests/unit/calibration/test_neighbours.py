"""The cone method as its source has it, against OpenCV on the same poses."""

import cv2
import numpy as np
import pytest

from calibration.hand_eye import se3
from calibration.hand_eye.neighbours import across, mean_of_means, neighbour_estimates, within
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import prepare
from tests.kit.hand_eye_scene import CAMERA, X_TRUE, make_scene


def problem_of(setup: str, flange_t: float, flange_r: float, px: float = 0.1) -> Problem:
    scene = make_scene(4, setup=setup, count=36, groups=3, px=px, flange_t=flange_t, flange_r=flange_r)
    return prepare(scene.measurements(), CAMERA)


def by_opencv(problem: Problem, rows: np.ndarray) -> np.ndarray:
    gripper, target = se3.inverse(problem.G[rows]), problem.C[rows]
    R, t = cv2.calibrateHandEye(
        list(gripper[:, :3, :3]),
        list(gripper[:, :3, 3]),
        list(target[:, :3, :3]),
        list(target[:, :3, 3]),
        method=cv2.CALIB_HAND_EYE_HORAUD,
    )
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, t.ravel()
    return X


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
@pytest.mark.parametrize(("flange_t", "flange_r"), [(2e-4, 2e-4), (1e-3, 3e-3)])
def test_each_estimate_and_both_figures_are_opencvs_on_the_same_triples(
    setup: str, flange_t: float, flange_r: float
) -> None:
    problem = problem_of(setup, flange_t, flange_r)
    found = neighbour_estimates(problem, np.arange(problem.n))
    theirs = [np.stack([by_opencv(problem, rows) for rows in p.rows]) for p in found]
    assert [len(p.X) for p in found] == [12, 12, 12]
    for ours, other in zip(found, theirs, strict=True):
        np.testing.assert_allclose(ours.X, other, rtol=0.0, atol=1e-9)
    # The two figures by NumPy alone.
    deviations = [np.std(X[:, :3, 3], axis=0, ddof=1) for X in theirs]
    expected = np.sqrt(np.mean(np.square(deviations), axis=0))
    spread = within(found)
    assert spread is not None
    np.testing.assert_allclose(spread.t, expected, rtol=0.0, atol=1e-9)
    means = np.stack([X[:, :3, 3].mean(axis=0) for X in theirs])
    between = across(found)
    assert between is not None
    np.testing.assert_allclose(between.t, np.std(means, axis=0, ddof=1), rtol=0.0, atol=1e-9)


def test_perfect_poses_give_the_truth_and_no_spread() -> None:
    problem = problem_of("eye-in-hand", 0.0, 0.0, px=0.0)
    found = neighbour_estimates(problem, np.arange(problem.n))
    for least_squares in (False, True):
        X = mean_of_means(found, least_squares)
        assert X is not None
        np.testing.assert_allclose(X, X_TRUE.as_matrix(), atol=1e-5)
    spread = within(found)
    assert spread is not None
    assert np.linalg.norm(spread.t) < 1e-4


def test_neighbours_are_those_on_the_cone_and_not_those_in_time() -> None:
    problem = problem_of("eye-in-hand", 2e-4, 2e-4)
    order = np.random.default_rng(1).permutation(problem.n)
    mixed = problem.take(order)
    on_the_cone = neighbour_estimates(problem, np.arange(problem.n))
    found = neighbour_estimates(mixed, order)
    for ours, wanted in zip(found, on_the_cone, strict=True):
        np.testing.assert_allclose(ours.mean(), wanted.mean(), atol=1e-12)
    in_time = neighbour_estimates(mixed, np.arange(problem.n))
    first, second = within(found), within(in_time)
    assert first is not None
    assert second is not None
    assert np.linalg.norm(first.t - second.t) > 1e-4, "another order is another figure"


def test_poses_that_turn_about_one_axis_give_no_estimate() -> None:
    problem = problem_of("eye-in-hand", 0.0, 0.0, px=0.0)
    about_z = np.tile(np.eye(4), (problem.n, 1, 1))
    for k in range(problem.n):
        c, s = np.cos(0.1 * k), np.sin(0.1 * k)
        about_z[k, :2, :2] = [[c, -s], [s, c]]
    turned = Problem(problem.setup, about_z, about_z, problem.group, problem.cov_px, problem.sse, problem.dof)
    found = neighbour_estimates(turned, np.arange(turned.n))
    assert [(len(p.X), p.least_squares) for p in found] == [(0, None)] * 3
    assert mean_of_means(found) is None
