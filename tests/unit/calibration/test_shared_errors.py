"""Errors that neighbouring poses share, where an arm's joints are not known."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.shared_errors import ATTITUDE, PLACE, shared_errors
from calibration.adjustment.twists import StoredTwists
from calibration.adjustment.unknowns import ArmKnown, arm_terms
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Measurements, Solution, solve
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, capture, world


def poses(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(0.4 * rng.normal(size=(n, 3)))
    return RigidTransform.from_components(0.5 + 0.2 * rng.normal(size=(n, 3)), turns).as_matrix()


def test_the_functions_have_the_covariance_of_the_errors() -> None:
    """Of a field with a rational quadratic correlation, written down once more here."""
    F = poses(12)
    subject = shared_errors(F)
    values = subject.functions(F)
    for i, k in ((0, 0), (0, 1), (3, 7), (11, 2)):
        apart = np.sum((F[i, :3, 3] - F[k, :3, 3]) ** 2) / subject.reach**2
        angle = Rotation.from_matrix(F[i, :3, :3].T @ F[k, :3, :3]).magnitude()
        apart += 8.0 / 3.0 * np.sin(angle / 2.0) ** 2
        assert values[i] @ values[k] == pytest.approx(1.0 / (1.0 + apart / 2.0), abs=1e-4)
    assert np.all(subject.unexplained(F) < 1e-4)
    far = F[:1].copy()
    far[0, :3, 3] += 10.0
    assert subject.unexplained(far)[0] > 0.9


def test_a_term_moves_the_flange_along_an_axis_of_the_base() -> None:
    F = poses(5)
    subject = shared_errors(F)
    names, sigma = subject.blocks()[PLACE]
    count = len(names) // 3 - 1  # the last three are along the axes of the flange
    assert len(sigma) == len(names)
    place, attitude = np.split(subject.twists(F).columns(slice(None)), 2, axis=2)
    for columns, part in ((place, slice(3)), (attitude, slice(3, 6))):
        in_base = F[:, :3, :3] @ columns[:, part]
        assert np.abs(in_base[:, 1:, :count]).max() < 1e-12, "the first functions are those along x"
        assert np.abs(in_base[:, 0, count:-3]).max() < 1e-12
        np.testing.assert_allclose(in_base[:, 0, :count], subject.functions(F), atol=1e-12)
        np.testing.assert_array_equal(columns[:, part, -3:], np.tile(np.eye(3), (5, 1, 1)))
    assert not place[:, 3:].any()
    assert not attitude[:, :3].any()


def test_terms_that_are_made_when_wanted_are_those_that_are_kept() -> None:
    F, rng = poses(7), np.random.default_rng(2)
    made = shared_errors(F).twists(F)
    kept = StoredTwists(made.columns(slice(None)))
    assert made.numbers == kept.numbers
    x, by = rng.normal(size=made.numbers), rng.normal(size=(3, 6, 6))
    np.testing.assert_allclose(made.moved(x), kept.moved(x), atol=1e-12)
    out = np.empty((2, 3, 6, made.numbers))
    for subject, where in zip((made, kept), out, strict=True):
        subject.carried(by, slice(4, 7), where)
    np.testing.assert_allclose(*out, atol=1e-12)


def test_many_poses_have_functions_that_leave_little_and_take_little_memory() -> None:
    few, many = poses(200), poses(5000)
    assert np.mean(shared_errors(few).unexplained(few)) < 0.02
    subject = shared_errors(many)
    assert len(many) * subject.mixed.shape[1] <= 80_000
    assert np.mean(subject.unexplained(many)) < 0.1


@pytest.mark.parametrize("arm_m", [0.0, 2e-4])
def test_the_stated_covariance_bears_an_arm_whose_joints_are_not_known(arm_m: float) -> None:
    """Errors of six captures, and those of an arm taken as exact beside them."""
    squared: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(6):
        rng = np.random.default_rng([seed, 5])
        cell = world(rng, arm_m, "exact", "exact", joints=11)
        measured, _ = capture(rng, cell, "few on cones")
        first = solve(measured, CAMERA, {})
        assert isinstance(first, Solution)
        for shared in squared:
            found = adjust(measured, first, CAMERA, shared_errors(measured.F[first.used]) if shared else None)
            error = se3.log(se3.inverse(found.X) @ cell.X)
            squared[shared].append(float(error @ np.linalg.solve(found.cov, error)))
    assert 3.0 < np.mean(squared[True]) < 11.0  # a mean of six with six degrees of freedom: 6 +- 1.4
    if arm_m:
        assert np.mean(squared[False]) > 2.0 * np.mean(squared[True])


def test_the_size_of_an_axis_is_that_of_a_nominal_arm_over_all_its_joints() -> None:
    Q = reference_joints(ARM.joint_limits)
    terms = arm_terms(ArmKnown(MODEL, Q, ARM.joint_limits), Q)["geometry"]
    subject = shared_errors(poses(5))
    for block, part in ((PLACE, slice(3)), (ATTITUDE, slice(3, 6))):
        axis = np.sqrt(np.mean(np.sum((terms.columns[:, part] * terms.sigma) ** 2, axis=(1, 2))) / 3.0)
        assert subject.sigma[block] == pytest.approx(axis, rel=0.03)


def test_first_and_last_link_move_base_and_flange_by_one_unit_of_an_arms_errors() -> None:
    """Of the chain's numbers as priors have them: what they do to base and flange as a whole."""
    terms = arm_terms(ArmKnown(MODEL, np.zeros((1, 6)), ARM.joint_limits), np.zeros((1, 6)))["geometry"]
    ends = np.sqrt(np.sum((terms.gauge * terms.sigma) ** 2, axis=1))
    stated = np.concatenate(shared_errors(poses(5)).ends({PLACE: 1.0, ATTITUDE: 1.0}, {}))
    np.testing.assert_allclose(stated, ends, rtol=0.1, atol=2e-5)


def test_noise_of_single_poses_may_be_the_arms_errors_too() -> None:
    """Poses of different branches share next to nothing of an arm's errors."""
    subject = shared_errors(poses(5))
    _, flange = subject.ends({PLACE: 0.1, ATTITUDE: 0.1}, {"sigma_px": 0.2, "sigma_flange_t": 4e-4})
    assert flange[0] == pytest.approx(np.hypot(0.042e-3, 0.4e-3) / 2.1, rel=1e-3)
    assert flange[3] == pytest.approx(0.1 * 3e-4, rel=1e-3)


def by_poses(measured: Measurements, first: Solution) -> Adjusted:
    return adjust(measured, first, CAMERA, shared_errors(measured.F[first.used]))


def test_the_cause_of_the_uncertainty_is_named_and_a_better_arm_leaves_less_of_it() -> None:
    rng = np.random.default_rng([1, 5])
    cell = world(rng, 2e-4, "exact", "exact")
    measured, _ = capture(rng, cell, "cone")
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    found = by_poses(measured, first)
    total = sum(found.budget.values())
    np.testing.assert_allclose(total, np.diag(found.cov), rtol=1e-6)
    share = found.budget[PLACE] + found.budget[ATTITUDE]
    assert np.all(share[:3] > 0.3 * np.diag(found.cov)[:3])
    perfect = world(np.random.default_rng([1, 5]), 0.0, "exact", "exact")
    measured, _ = capture(np.random.default_rng(3), perfect, "cone")
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    better = by_poses(measured, first)
    assert better.components.scale[PLACE] < 0.3 < found.components.scale[PLACE]
