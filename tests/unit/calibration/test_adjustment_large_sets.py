"""Every block from thousands of poses: what is hardly known stays where its prior and the data have it."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.adjustment.components import Components
from calibration.adjustment.equations import Observations, Prior
from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.jackknife import jackknife
from calibration.adjustment.lens_terms import image_terms, target_shape
from calibration.adjustment.shared_errors import shared_errors
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Solution, solve
from tests.kit import imperfect_cell
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, X_NOMINAL

TIMES = 25  # each pose, every time with noise of its own


def test_arm_target_and_camera_do_not_shrink_together_with_the_number_of_poses() -> None:
    rng = np.random.default_rng([0, 5])
    cell = imperfect_cell.world(rng, 2e-4, "exact", "exact", joints=11)
    measured, Q = imperfect_cell.capture(rng, cell, "diverse")
    placements: list[list[imperfect_cell.Seen]] = [[] for _ in range(measured.group.max() + 1)]
    for k, view in enumerate(measured.views):
        assert view is not None
        assert view.start is not None
        W = RigidTransform.from_matrix(measured.F[k] @ X_NOMINAL.as_matrix() @ view.start)
        own = placements[measured.group[k]]
        own += [imperfect_cell.seen_from(rng, cell, Q[k], W, view.start) for _ in range(TIMES)]
    measured, Q = imperfect_cell.gathered(placements)
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    found = adjust(measured, first, CAMERA, ArmKnown(MODEL, Q, ARM.joint_limits))
    size = found.names.index("scale_x")
    assert abs(found.numbers[size]) < 4.0 * found.sigma[size]
    assert found.components.scale["geometry"] < 3.0
    off = se3.log(se3.inverse(found.X) @ cell.X)[:3]
    assert np.linalg.norm(off) < 4.0 * np.sqrt(np.trace(found.cov[:3, :3]))


def many(n: int = 700, unknowns: int = 8, groups: int = 3) -> tuple[Observations, Prior]:
    """More observations than are taken at once, of local poses that are not in order."""
    rng = np.random.default_rng(7)
    half = rng.normal(size=(n, 6, 6))
    obs = Observations(
        rng.normal(size=(n, 6)),
        rng.normal(size=(n, 6, unknowns)),
        rng.normal(size=(n, 6, 6)),
        rng.permutation(np.arange(n) % groups),
        (half @ np.swapaxes(half, 1, 2) + 6.0 * np.eye(6))[None],
        np.eye(unknowns),
        np.ones(unknowns),
        0.0,
        0.0,
    )
    return obs, Prior(np.zeros(unknowns), np.array([np.inf] * 6 + [0.5] * (unknowns - 6)), {})


def test_equations_in_parts_are_those_of_all_observations_and_poses_at_once() -> None:
    obs, prior = many()
    subject = Components({"noise": 2.0}, {}, frozenset(), of_sums="noise").equations(obs, prior, np.zeros(8))
    J = np.zeros((obs.n, 6, 8 + 6 * obs.groups))
    J[:, :, :8] = obs.of_global
    for k, g in enumerate(obs.group):
        J[k, :, 8 + 6 * g : 14 + 6 * g] = obs.of_local[k]
    P = np.linalg.inv(4.0 * obs.parts[0])
    N = np.einsum("nia,nij,njb->ab", J, P, J, optimize=True)
    g = np.einsum("nia,nij,nj->a", J, P, obs.r, optimize=True)
    N[:8, :8] += obs.info / 4.0 + np.diag(prior.precision)
    g[:8] += obs.pull / 4.0
    x, w = subject.step()
    np.testing.assert_allclose(np.concatenate([x, w.ravel()]), -np.linalg.solve(N, g), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(subject.covariance, np.linalg.inv(N)[:8, :8], rtol=1e-9, atol=1e-15)


def test_leaving_out_of_many_observations_does_not_depend_on_their_order() -> None:
    obs, prior = many()
    order = np.argsort(obs.group, kind="stable")
    rows = {key: getattr(obs, key)[order] for key in ("r", "of_global", "of_local", "group")}
    sorted_ = Observations(**rows, parts=obs.parts[:, order], info=obs.info, pull=obs.pull, sse=0.0, dof=0.0)
    noise = Components({"noise": 2.0}, {}, frozenset(), of_sums="noise")
    one, other = (jackknife(o, noise, noise.equations(o, prior, np.zeros(8)), 6) for o in (obs, sorted_))
    np.testing.assert_allclose(one.cov, other.cov, rtol=1e-9)
    np.testing.assert_allclose(one.expected[order], other.expected, rtol=1e-9, atol=1e-15)


def test_what_images_say_of_lens_and_target_is_that_of_each_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("calibration.hand_eye.views._BLOCK", 128)
    rng = np.random.default_rng(1)
    measured, _ = imperfect_cell.capture(rng, imperfect_cell.world(rng, 0.0, "exact", "exact"), "diverse")
    views = [v for v in measured.views if v is not None]
    C = np.stack([v.start for v in views if v.start is not None])
    shape = target_shape(views)
    subject = image_terms(views, C, CAMERA, shape, C @ se3.exp(np.full(6, 1e-4)))
    assert len(views) > 128
    info, pull = np.zeros_like(subject.info), np.zeros_like(subject.pull)
    for k in range(len(views)):
        one = image_terms(
            views[k : k + 1], C[k : k + 1], CAMERA, shape, C[k : k + 1] @ se3.exp(np.full(6, 1e-4))
        )
        np.testing.assert_allclose(subject.moves[k], one.moves[0], rtol=1e-9, atol=1e-12)
        info += one.info
        pull += one.pull
    np.testing.assert_allclose(subject.info, info, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(subject.pull, pull, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("joints", [True, False], ids=["joints", "no joints"])
def test_derivatives_that_are_made_when_wanted_lead_to_the_answer_of_those_that_are_kept(
    joints: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng([0, 5])
    measured, Q = imperfect_cell.capture(
        rng, imperfect_cell.world(rng, 2e-4, "off", "bow", joints=11), "few on cones"
    )
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    arm = ArmKnown(MODEL, Q, ARM.joint_limits) if joints else shared_errors(measured.F[first.used])
    kept = adjust(measured, first, CAMERA, arm)
    monkeypatch.setattr("calibration.adjustment.unknowns._MANY", 1)
    subject = adjust(measured, first, CAMERA, arm)
    np.testing.assert_allclose(subject.X, kept.X, atol=1e-12)
    np.testing.assert_allclose(subject.cov, kept.cov, rtol=1e-7, atol=1e-18)
    np.testing.assert_allclose(subject.numbers, kept.numbers, atol=1e-9)
