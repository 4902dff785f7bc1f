"""What planned poses will tell of the camera's pose, before anything moves: the adjustment's own information.

The same normal equations and priors as the adjustment that judges the run, at views without noise. What is
not known of arm, lens and target is therefore in the prediction, by cause, and so are the limits that no
number of poses lifts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calibration.adjustment.components import Components
from calibration.adjustment.lens_terms import LensPrior, TargetPrior, image_terms, target_shape
from calibration.adjustment.unknowns import AdjustedState, ArmKnown, budget, observations, unknowns
from calibration.hand_eye import se3
from calibration.hand_eye.normal import linearise
from calibration.hand_eye.pnp import refine_poses
from calibration.hand_eye.problem import Estimate, Problem, Setup
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array


@dataclass(frozen=True)
class PlannedViews:
    """Poses of one placement: ``F`` (n, 4, 4) are T_base_flange, ``C`` (n, 4, 4) T_camera_target of a target
    with ``points`` (m, 3), and ``X`` (4, 4) is the camera's pose, as far as it is known."""

    F: Array
    C: Array
    X: Array
    points: Array


@dataclass(frozen=True)
class ExpectedCovariance:
    """``cov`` (6, 6) of the camera's pose, perturbation on the right; ``budget``: its variances (6,) by
    block; ``sigma`` by the names of the unknowns; ``cov_arm`` (a, a) of the arm's numbers, which come first
    among them."""

    cov: Array
    budget: Mapping[str, Array]
    sigma: Mapping[str, float]
    cov_arm: Array


def expected(
    setup: Setup,
    views: PlannedViews,
    camera: Intrinsics,
    noise: Mapping[str, float],
    arm: ArmKnown | None,
    lens: LensPrior,
    target: TargetPrior,
    placements: int = 1,
) -> ExpectedCovariance:
    """``placements`` placements like this one: what the arm errs by is the same in each of them.

    ``noise`` has ``sigma_px``, ``sigma_flange_t`` (m) and ``sigma_flange_r`` (rad). ``arm`` has the joints of
    ``views``; without it the flange's poses are taken as exact but for their noise.
    """
    problem, corners = _seen(setup, views, camera)
    of = unknowns(problem, np.arange(problem.n), arm, lens, target)
    none = np.zeros(len(of.names))
    at = Estimate(views.X, problem.target_poses(views.X)[:1])
    state = AdjustedState(problem, at, none, none, Components(dict(noise), {}, frozenset()))
    images = image_terms(corners, problem.C, camera, target_shape(corners))
    obs = observations(of, state, images, linearise(problem, state.at))
    eq = state.components.equations(obs, of.prior, np.zeros(6 + len(none)))
    prior = np.diag(of.prior.precision)
    eq = replace(eq, N=placements * (eq.N - prior) + prior)
    return ExpectedCovariance(
        eq.covariance[:6, :6],
        budget(eq, of.blocks),
        dict(zip(of.names, map(float, np.sqrt(np.diag(eq.covariance)[6:])), strict=True)),
        eq.covariance[6:, 6:][of.arm, of.arm],
    )


def _seen(setup: Setup, views: PlannedViews, camera: Intrinsics) -> tuple[Problem, list[CornerSet]]:
    """The views as a camera without noise has them, every point of the target in each."""
    corners = []
    for C in views.C:
        pixels, _ = cv2.projectPoints(
            views.points, cv2.Rodrigues(C[:3, :3])[0], C[:3, 3], camera.matrix, np.array(camera.dist)
        )
        corners.append(
            CornerSet(views.points, pixels.reshape(-1, 2).astype(float), np.ones(len(views.points)), C)
        )
    poses = refine_poses(corners, camera, views.C)
    G = se3.inverse(views.F) if setup == "eye-in-hand" else views.F
    n = len(views.F)
    dof = np.asarray(2.0 * poses.corners - 6.0, dtype=float)
    return Problem(setup, G, views.C, np.zeros(n, np.int64), poses.cov, np.zeros(n), dof), corners
