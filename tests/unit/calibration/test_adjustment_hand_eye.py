"""Hand-eye with arm, lens and board as unknowns: the stated uncertainty holds where the models are wrong."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.adjustment.arm_terms import ArmPrior
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.adjustment.unknowns import GEARS, GEOMETRY, ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Measurements, Solution, solve
from cell.poses import Array
from tests.kit.imperfect_cell import (
    ARM,
    CAMERA,
    FLANGE_R,
    FLANGE_T,
    MODEL,
    PX,
    World,
    capture,
    capture_eye_to_hand,
    world,
)

# The mean of 6 squared distances of six numbers each is 6; chance takes it out of these in 1 of 1000 cases.
SEEDS, LEAST, MOST = range(6), 2.5, 11.3


def captured(seed: int, arm: float, lens: str, board: str, plan: str) -> tuple[World, Measurements, Array]:
    rng = np.random.default_rng([seed, 11])
    cell = world(rng, arm, lens, board, joints=13 if arm > 2e-4 else 11)
    return cell, *capture(rng, cell, plan)


def both(measured: Measurements, Q: Array) -> tuple[Solution, Adjusted]:
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    return first, adjust(measured, first, CAMERA, ArmKnown(MODEL, Q, ARM.joint_limits))


def nees(X: Array, cov: Array, truth: Array) -> float:
    e = se3.log(se3.inverse(X) @ truth)
    return float(e @ np.linalg.solve(cov, e))


@pytest.mark.parametrize(
    ("arm", "lens", "board", "plan"),
    [
        (0.0, "off", "bow", "few on cones"),
        (2e-4, "exact", "scale", "few branches"),
        (2e-4, "off", "bow", "cone"),
        (2e-3, "exact", "exact", "few branches"),
    ],
)
def test_errors_are_as_large_as_stated(arm: float, lens: str, board: str, plan: str) -> None:
    ours, alone = [], []
    for seed in SEEDS:
        cell, measured, Q = captured(seed, arm, lens, board, plan)
        first, subject = both(measured, Q)
        ours.append(nees(subject.X, subject.cov, cell.X))
        alone.append(nees(first.at.X, first.cov, cell.X))
    assert LEAST < np.mean(ours) < MOST
    if lens == "off":
        assert np.mean(alone) > 10.0 * MOST, "with noise alone the same data state far too little"


def test_the_quality_of_the_arm_and_the_lens_are_found() -> None:
    cell, measured, Q = captured(3, 2e-4, "off", "exact", "branches")
    subject = both(measured, Q)[1]
    assert all(0.5 < subject.components.scale[name] < 2.0 for name in (GEOMETRY, GEARS))
    k = subject.names.index("focal")
    true = cell.camera.K[0] / CAMERA.K[0] - 1.0
    assert abs(subject.numbers[k] - true) < 3.0 * subject.sigma[k] < 0.3 * abs(true)


def test_a_good_arm_is_found_to_be_one() -> None:
    subject = both(*captured(1, 0.0, "exact", "exact", "branches")[1:])[1]
    assert subject.components.scale[GEOMETRY] < 0.35


def test_an_answer_of_few_poses_is_the_one_with_the_scales_that_it_states() -> None:
    """Found again with the arm's prior of those scales, and no scale free: nothing moves."""
    rng = np.random.default_rng([1, 6])
    measured, Q = capture(rng, world(rng, 2e-4, "exact", "exact", joints=11), "one cone")
    levels = {"sigma_px": PX, "sigma_flange_t": FLANGE_T, "sigma_flange_r": FLANGE_R}
    first = solve(measured, CAMERA, levels)
    assert isinstance(first, Solution)
    known = ArmKnown(MODEL, Q, ARM.joint_limits)
    subject = adjust(measured, first, CAMERA, known)
    usual, geometry, gears = ArmPrior(), *(subject.components.scale[name] for name in (GEOMETRY, GEARS))
    lengths, joints = (
        geometry * np.array([usual.length, usual.angle]),
        gears * np.array([usual.gear, usual.sag]),
    )
    again = adjust(
        measured, first, CAMERA, replace(known, prior=ArmPrior(*lengths, *joints), scale_free=False)
    )
    off = se3.log(se3.inverse(again.X) @ subject.X) / np.sqrt(np.diag(again.cov))
    assert np.abs(off).max() < 0.01
    assert np.abs((subject.numbers - again.numbers) / again.sigma).max() < 0.01
    np.testing.assert_allclose(subject.cov, again.cov, rtol=0.01, atol=1e-3 * again.cov.max())


def test_the_budget_adds_up_and_a_known_lens_takes_its_part_away() -> None:
    _, measured, Q = captured(2, 2e-4, "exact", "exact", "cone")
    first, subject = both(measured, Q)
    np.testing.assert_allclose(sum(subject.budget.values()), np.diag(subject.cov), rtol=1e-9)
    assert all(np.all(part >= 0.0) for part in subject.budget.values())
    exact = LensPrior(1e-9, 1e-9, 1e-6, 1e-9, 1e-9)
    known = adjust(
        measured, first, CAMERA, ArmKnown(MODEL, Q, ARM.joint_limits), exact, TargetPrior(1e-9, 1e-9)
    )
    assert np.all(known.budget["lens"] < 1e-6 * np.diag(known.cov))
    assert np.trace(known.cov[:3, :3]) < np.trace(subject.cov[:3, :3])


def test_errors_are_as_large_as_stated_for_a_camera_in_the_base() -> None:
    values = []
    for seed in SEEDS:
        rng = np.random.default_rng([seed, 13])
        measured, Q, truth = capture_eye_to_hand(
            rng, world(rng, 2e-4, "exact", "exact", joints=11), "one cone"
        )
        subject = both(measured, Q)[1]
        values.append(nees(subject.X, subject.cov, truth))
    assert LEAST < np.mean(values) < MOST
