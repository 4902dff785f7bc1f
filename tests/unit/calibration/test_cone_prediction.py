"""The accuracy that a plan promises, against OpenCV's solver and Monte Carlo."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.adjustment.prediction import PlannedViews, expected
from calibration.planning import (
    ConeShape,
    EyeInHand,
    EyeToHand,
    Mounting,
    PlannedPose,
    PredictedUncertainty,
    cone_poses,
)
from cell.devices import Intrinsics
from cell.poses import Array, exp_xi, from_pose6, log_xi

CAMERA = Intrinsics(1280, 800, (802.4, 801.7, 644.2, 396.8))
X = from_pose6([0.006, -0.0864, 0.0548, 0.03, -0.03, 0.4])
W = from_pose6([-0.7415, -0.3064, 0.1218, -2.0819, -2.0044, 0.2075])
SIGMA_PX, SIGMA_T, SIGMA_R = 0.2, 5e-5, 1e-4
FLANGE = np.array([SIGMA_T] * 3 + [SIGMA_R] * 3)


def board_points() -> Array:
    x, y = np.meshgrid(np.arange(1, 10), np.arange(1, 7))
    return 0.025 * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def pnp_covariance(
    T_camera_target: RigidTransform, target_points: Array, intrinsics: Intrinsics, sigma_px: float
) -> Array:
    """(6, 6) covariance of ``T_camera_target`` (right perturbation) from corners with ``sigma_px``."""
    p = np.asarray(target_points, dtype=float)
    R = T_camera_target.rotation.as_matrix()
    x, y, z = T_camera_target.apply(p).T
    fx, fy, _, _ = intrinsics.K
    zero = np.zeros_like(z)
    pixel = np.stack(
        [np.stack([fx / z, zero, -fx * x / z**2], axis=1), np.stack([zero, fy / z, -fy * y / z**2], axis=1)],
        axis=1,
    )
    J = pixel @ R @ np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -_skew(p)], axis=2)
    rows = J.reshape(-1, 6)
    cov: Array = sigma_px**2 * np.linalg.inv(rows.T @ rows)
    return cov


def _skew(v: Array) -> Array:
    """(n, 3, 3) cross product matrices of ``v`` (n, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - out.swapaxes(1, 2)


def planned(mounting: Mounting) -> list[PlannedPose]:
    shape = ConeShape(10, 0.44, 0.5)
    views = cone_poses(from_pose6([0.125, 0.0875, 0, 0, 0, 0]), shape).inv()
    flanges = mounting.flange(views)
    return [PlannedPose(k, np.zeros(6), flanges[k], views[k], 0.0) for k in range(10)]


def predicted(
    mounting: EyeInHand | EyeToHand, poses: list[PlannedPose], placements: int = 1
) -> PredictedUncertainty:
    """With an exact arm, lens and board."""
    exact = 1e-9
    found = expected(
        "eye-in-hand" if isinstance(mounting, EyeInHand) else "eye-to-hand",
        PlannedViews(
            np.stack([p.T_base_flange.as_matrix() for p in poses]),
            np.stack([p.T_camera_target.as_matrix() for p in poses]),
            mounting.X.as_matrix(),
            board_points(),
        ),
        CAMERA,
        {"sigma_px": SIGMA_PX, "sigma_flange_t": SIGMA_T, "sigma_flange_r": SIGMA_R},
        None,
        LensPrior(exact, exact, exact, exact, exact),
        TargetPrior(exact, exact),
        placements,
    )
    return PredictedUncertainty(found.cov)


def test_the_covariance_of_a_board_pose_is_what_opencv_scatters() -> None:
    view = from_pose6([-0.1, -0.12, 0.55, 0.35, -0.2, 0.1])
    rvec, tvec = view.rotation.as_rotvec(), view.translation
    clean, _ = cv2.projectPoints(board_points(), rvec, tvec, CAMERA.matrix, None)
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(600):
        noisy = clean + rng.normal(0, 0.3, clean.shape)
        _, r, t = cv2.solvePnP(
            board_points(),
            noisy,
            CAMERA.matrix,
            None,
            rvec.copy(),
            view.translation.reshape(3, 1).copy(),
            True,
        )
        found = from_pose6([*t.ravel(), *r.ravel()])
        errors.append(log_xi(view.inv() * found))
    scatter = np.cov(np.array(errors).T)
    predicted = pnp_covariance(view, board_points(), CAMERA, 0.3)
    np.testing.assert_allclose(np.sqrt(np.diag(scatter) / np.diag(predicted)), 1.0, atol=0.12)


@pytest.mark.parametrize("kind", ["eye-in-hand", "eye-to-hand"])
def test_the_predicted_covariance_is_what_maximum_likelihood_scatters(kind: str) -> None:
    """Each trial draws corner and flange noise, and solves X and W by weighted least squares."""
    mounting: EyeInHand | EyeToHand = EyeInHand(X, W) if kind == "eye-in-hand" else EyeToHand(W, X)
    unknown, other = (X, W) if kind == "eye-in-hand" else (W, X)
    poses = planned(mounting)
    rng = np.random.default_rng(11)
    F_true = RigidTransform.concatenate([p.T_base_flange for p in poses])
    views = RigidTransform.concatenate([p.T_camera_target for p in poses])
    pnp = np.array([pnp_covariance(v, board_points(), CAMERA, SIGMA_PX) for v in views])

    def gaps(z: Array, F: RigidTransform, seen: RigidTransform) -> Array:
        x, w = unknown * exp_xi(z[..., :6]), other * exp_xi(z[..., 6:])
        return log_xi((x.inv() * (F.inv() if kind == "eye-in-hand" else F) * w).inv() * seen)

    # How flange noise shows in the view and how the unknowns do, by finite differences.
    step, zero = 1e-6, np.zeros(12)
    D = np.stack([gaps(zero, F_true * exp_xi(step * e), views) for e in np.eye(6)], axis=2) / step
    roots = np.linalg.inv(np.linalg.cholesky(pnp + D @ np.diag(FLANGE**2) @ D.swapaxes(1, 2)))
    J = np.stack([gaps(step * e, F_true, views) for e in np.eye(12)], axis=2) / step
    solve = np.linalg.pinv((roots @ J).reshape(-1, 12))

    trials = 400
    which = np.tile(np.arange(len(poses)), trials)  # all trials at once, one after the other
    F = F_true[which] * exp_xi(rng.normal(0, FLANGE, (len(which), 6)))
    noise = np.linalg.cholesky(pnp)[which] @ rng.normal(size=(len(which), 6, 1))
    seen, z = views[which] * exp_xi(noise[..., 0]), np.zeros((trials, 12))
    for _ in range(2):  # Gauss-Newton; the second step is already far below the noise
        left = roots[which] @ gaps(np.repeat(z, len(poses), axis=0), F, seen)[..., None]
        z = z - left.reshape(trials, -1) @ solve.T
    errors = z[:, :6]
    subject = predicted(mounting, poses)
    nees = [e @ np.linalg.solve(subject.cov, e) for e in errors]
    assert 6.0 * 0.9 < np.mean(nees) < 6.0 * 1.1  # 3.5 standard errors of 400 draws
    shorter = np.mean([np.linalg.norm(e[:3]) < subject.error95_t_m for e in errors])
    assert 0.91 < shorter < 0.99


def test_more_placements_shrink_the_error_with_their_root() -> None:
    mounting = EyeInHand(X, W)
    poses = planned(mounting)
    one, four = predicted(mounting, poses), predicted(mounting, poses, placements=4)
    assert one.sigma_t_m == pytest.approx(2 * four.sigma_t_m)
    assert one.error95_r_rad == pytest.approx(2 * four.error95_r_rad)


@pytest.mark.parametrize("variances", [(1.0, 1.0, 1.0), (1.0, 0.3, 0.1), (1.0, 1e-4, 1e-4)])
def test_the_95_percent_length_holds_for_round_and_long_covariances(variances: tuple[float, ...]) -> None:
    cov = np.zeros((6, 6))
    cov[:3, :3] = np.diag(variances)
    cov[3:, 3:] = np.eye(3)
    samples = np.random.default_rng(0).normal(0, np.sqrt(variances), (200_000, 3))
    inside = np.mean(np.linalg.norm(samples, axis=1) < PredictedUncertainty(cov).error95_t_m)
    assert inside == pytest.approx(0.95, abs=0.004)
