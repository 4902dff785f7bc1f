"""Building blocks of the hand-eye solver against independent ones: SciPy, OpenCV, finite differences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.hand_eye import se3
from calibration.hand_eye.noise import Noise, reml, weights
from calibration.hand_eye.normal import gauss_newton, linearise, normal
from calibration.hand_eye.pnp import solve_pnp
from calibration.hand_eye.pnp_start import first_guesses
from calibration.hand_eye.problem import Estimate, residuals
from calibration.hand_eye.solution import prepare
from calibration.hand_eye.views import CornerSet, distortion_jacobian, project, undistort
from cell.poses import exp_xi, log_xi
from tests.kit.hand_eye_scene import CAMERA, POINTS, X_TRUE, cone_views, make_scene

vectors = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(np.array)


@given(vectors)
def test_exponential_and_logarithm_agree_with_scipy(xi: np.ndarray) -> None:
    T = se3.exp(xi)
    assert np.allclose(T, exp_xi(xi).as_matrix(), atol=1e-12)
    assert np.allclose(se3.log(T), log_xi(exp_xi(xi)), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-7])
def test_rotation_vectors_hold_from_nothing_to_half_a_turn(angle: float) -> None:
    w = angle * np.array([0.6, -0.64, 0.48])
    assert np.allclose(se3.rotation_vectors(se3.exp(np.r_[0, 0, 0, w])[:3, :3]), w, atol=1e-9)


@given(vectors)
def test_right_jacobian_is_the_derivative_of_the_logarithm(xi: np.ndarray) -> None:
    xi = 0.25 * xi
    h = 1e-6
    numeric = np.stack(
        [
            (se3.log(se3.exp(xi) @ se3.exp(e)) - se3.log(se3.exp(xi) @ se3.exp(-e))) / (2 * h)
            for e in h * np.eye(6)
        ],
        axis=1,
    )
    assert np.allclose(se3.right_jacobian_inverse(xi), numeric, atol=2e-5)


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_jacobians_of_the_residual_agree_with_finite_differences(setup: str) -> None:
    problem = prepare(make_scene(setup=setup, count=6, groups=2).measurements(), CAMERA)
    at = Estimate(X_TRUE.as_matrix(), np.stack([problem.target_poses(X_TRUE.as_matrix())[k] for k in (0, 3)]))
    at = at.moved(np.full((3, 6), 0.02))
    J = linearise(problem, at).J
    h = 1e-6
    for block, column in ((0, 0), (1, 6), (2, 6)):
        mine = np.ones(6, dtype=bool) if block == 0 else problem.group == block - 1
        for k in range(6):
            delta = np.zeros((3, 6))
            delta[block, k] = h
            numeric = (residuals(problem, at.moved(delta))[0] - residuals(problem, at.moved(-delta))[0]) / (
                2 * h
            )
            assert np.allclose(J[mine, :, column + k], numeric[mine], atol=1e-6)
            assert np.allclose(numeric[~mine], 0.0)


def test_pose_from_corners_agrees_with_opencv() -> None:
    scene = make_scene(count=8, px=0.3)
    poses, owner = solve_pnp([CornerSet(POINTS, uv, np.ones(54)) for uv in scene.corners], CAMERA)
    for C, i in zip(poses.C, owner, strict=True):
        _, rvec, t = cv2.solvePnP(
            POINTS, scene.corners[i], CAMERA.matrix, np.array(CAMERA.dist), flags=cv2.SOLVEPNP_ITERATIVE
        )
        assert np.allclose(C[:3, 3], t.ravel(), atol=2e-6)
        assert np.allclose(C[:3, :3], cv2.Rodrigues(rvec)[0], atol=2e-5)


def test_poses_of_many_views_are_those_of_each_alone() -> None:
    rng = np.random.default_rng(5)
    views = []
    for k, uv in enumerate(make_scene(count=300, px=0.3).corners):
        seen = rng.random(54) < 0.8
        views.append(CornerSet((0.1 if k % 2 else 1.0) * POINTS[seen], uv[seen], np.ones(seen.sum())))
    poses, owner = solve_pnp(views, CAMERA)
    for k in (0, 1, 199, 200, 299):
        own, _ = solve_pnp(views[k : k + 1], CAMERA)
        assert np.allclose(poses.C[owner == k], own.C, atol=1e-10)
        assert np.allclose(poses.cov[owner == k], own.cov, rtol=1e-6)
        assert np.array_equal(poses.corners[owner == k], own.corners)


def test_corners_on_a_line_or_in_one_place_give_no_guess_and_do_not_stop_other_views() -> None:
    uv = make_scene(count=1).corners[0]
    seen = ((POINTS, uv), (POINTS[:9], uv[:9]), (POINTS[[3] * 9], uv[[3] * 9]), (POINTS, uv[[3] * 54]))
    guesses = first_guesses([CornerSet(p, corners, np.ones(len(p))) for p, corners in seen], CAMERA)
    assert list(np.isnan(guesses).any(axis=(1, 2))) == [False, True, True, True]


@pytest.mark.parametrize("turned", [0.0, 0.7])
def test_the_first_guess_of_a_perfect_image_is_the_pose(turned: float) -> None:
    T = exp_xi([0.1, -0.2, 0.3, turned, -turned, 0.2 * turned]).as_matrix()
    for C in (pose.as_matrix() for pose in cone_views(np.random.default_rng(6), 5)):
        p = POINTS @ C[:3, :3].T + C[:3, 3]
        view = CornerSet(POINTS @ T[:3, :3].T + T[:3, 3], project(p[:, :2] / p[:, 2:], CAMERA), np.ones(54))
        assert np.allclose(first_guesses([view], CAMERA)[0] @ T, C, atol=1e-9)


def test_covariance_of_a_pose_predicts_its_scatter() -> None:
    C = cone_views(np.random.default_rng(3), 1)[0]
    rng = np.random.default_rng(4)
    uv = make_scene(views=[C], count=1, px=0.0).corners[0]
    views = [
        CornerSet(POINTS, uv + 0.2 * rng.normal(size=uv.shape), np.ones(54), C.as_matrix())
        for _ in range(400)
    ]
    poses, _ = solve_pnp(views, CAMERA)
    xi = se3.log(poses.C @ se3.inverse(C.as_matrix()))
    nees = np.einsum("ni,nij,nj->n", xi, np.linalg.inv(0.04 * poses.cov), xi)
    assert 5.4 < nees.mean() < 6.6


def test_a_pose_that_is_mirrored_in_the_line_of_sight_is_kept_as_a_candidate() -> None:
    small = POINTS * 0.1
    C = cone_views(np.random.default_rng(1), 4)[1].as_matrix()
    p = small @ C[:3, :3].T + C[:3, 3]
    uv = project(p[:, :2] / p[:, 2:], CAMERA) + 0.3 * np.random.default_rng(2).normal(size=(54, 2))
    poses, owner = solve_pnp([CornerSet(small, uv, np.ones(54))], CAMERA)
    assert list(owner) == [0, 0]
    assert poses.sse[0] <= poses.sse[1]
    normals = poses.C[:, :3, 2]
    assert normals[0] @ normals[1] < 0.99


def test_a_pixel_that_the_lens_cannot_reach_leaves_the_others_as_they_are() -> None:
    camera = replace(CAMERA, dist=(-0.4, 0.0, 0.0, 0.0))
    ideal = np.array([[0.1, -0.2], [0.3, 0.2]])
    seen = undistort(np.concatenate([project(ideal, camera), [[2000.0, 400.0]]]), camera)
    assert np.allclose(seen[:2], ideal, atol=1e-12)
    assert np.array_equal(seen[2:], undistort(np.array([[2000.0, 400.0]]), camera), equal_nan=True)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_undistorting_is_the_inverse_of_projecting_and_has_its_derivative(count: int) -> None:
    full = (-0.12, 0.08, 1e-3, -5e-4, 0.01, 0.02, -0.01, 0.003, 1e-3, -2e-3, 5e-4, 1e-3, 0.01, -0.02)
    camera = replace(CAMERA, dist=full[:count])
    ideal = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 2))
    assert np.allclose(undistort(project(ideal, camera), camera), ideal, atol=1e-11)
    step = np.array([1e-5, -2e-5])
    linear = (distortion_jacobian(ideal, camera) @ step[:, None])[..., 0]
    numeric = (project(ideal + step, camera) - project(ideal - step, camera)) / 2
    assert np.allclose(numeric, linear, atol=1e-7)


def test_block_solution_equals_the_full_normal_equations() -> None:
    problem = prepare(make_scene(count=12, groups=3).measurements(), CAMERA)
    X = X_TRUE.as_matrix()
    lin = linearise(problem, Estimate(X, problem.target_poses(X)[::4]))
    P = np.linalg.inv(problem.cov_px + 1e-8 * np.eye(6))
    N, g = np.zeros((24, 24)), np.zeros(24)
    for i, k in enumerate(problem.group):
        J = np.zeros((6, 24))
        J[:, :6], J[:, 6 + 6 * k : 12 + 6 * k] = lin.J[i, :, :6], lin.J[i, :, 6:]
        N += J.T @ P[i] @ J
        g += J.T @ P[i] @ lin.r[i]
    equations = normal(lin, P)
    full = np.linalg.inv(N)
    assert np.allclose(equations.solve().ravel(), full @ g, rtol=1e-6, atol=1e-12)
    assert np.allclose(equations.covariance().X, full[:6, :6], rtol=1e-6, atol=1e-14)
    assert np.allclose(equations.covariance().own[1][:6, 6:], full[:6, 12:18], rtol=1e-6, atol=1e-13)


def test_noise_levels_come_out_without_bias() -> None:
    found = []
    for seed in range(12):
        problem = prepare(
            make_scene(seed, count=24, px=0.2, flange_t=2e-4, flange_r=4e-4).measurements(True), CAMERA
        )
        X = X_TRUE.as_matrix()
        start = Estimate(X, problem.target_poses(X)[:1])
        guess = Noise(
            {"sigma_px": 1.0, "sigma_flange_t": 1e-3, "sigma_flange_r": 1e-4},
            tuple(("sigma_px", "sigma_flange_t", "sigma_flange_r")),
        )

        lin = gauss_newton(problem, start, weights(linearise(problem, start), guess))
        found.append([v**2 for v in reml(lin, guess).sigma.values()])
    px, t, r = np.sqrt(np.mean(found, axis=0))
    assert px == pytest.approx(0.2, rel=0.03)
    assert t == pytest.approx(2e-4, rel=0.2)
    assert r == pytest.approx(4e-4, rel=0.2)
