"""The accuracy that is predicted where a task needs it holds for arms, lenses and boards that are off."""

from collections.abc import Iterator

import numpy as np
import pytest

from calibration.adjustment.arm_accuracy import arm_columns, arm_numbers, symmetric_root
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.task_accuracy import task_accuracy
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Measurements, Solution, solve
from cell.poses import Array
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, World, capture, capture_eye_to_hand, world

Q_TASK = np.array([0.3, -1.4, 1.9, -2.0, -1.5, 0.2])
AHEAD_M = 0.45
RUNS, LEAST = 20, 16  # of 20 errors with a chance of 0.95 each, fewer are below in 1 of 400 cases


def adjusted(measured: Measurements, Q: Array) -> tuple[Adjusted, ArmKnown]:
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    known = ArmKnown(MODEL, Q, ARM.joint_limits)
    return adjust(measured, first, CAMERA, known), known


def in_base(cell: World, q: Array) -> Array:
    """(4, 4): where the true flange is, in the frames that serve the arm's model best."""
    true = cell.true_flange(q[None])[0]
    return np.asarray(se3.inverse(cell.base) @ true @ se3.inverse(cell.flange))


def errors(setup: str) -> Iterator[tuple[bool, bool]]:
    """Of single captures: whether the error is below what is stated, as configured and as corrected."""
    for seed in range(RUNS):
        rng = np.random.default_rng([seed, 41])
        cell = world(rng, 2e-4 * rng.uniform(0.3, 2.0), "off", "bow", joints=11)
        q = Q_TASK + rng.uniform(-0.6, 0.6, 6)
        true = in_base(cell, q)
        if setup == "eye-in-hand":
            measured, Q = capture(rng, cell, "few")
            X_true = cell.X
        else:
            measured, Q, X_true = capture_eye_to_hand(rng, cell, "one cone")
        found, arm = adjusted(measured, Q)
        stated = task_accuracy(found, arm, q, AHEAD_M)
        nominal = arm.model.base.flange(q[None])[0]
        corrected = nominal @ se3.exp(arm_columns(arm, q[None])[0] @ found.numbers[arm_numbers(found)])
        below = []
        for flange, length in ((nominal, stated.configured95), (corrected, stated.corrected95)):
            if setup == "eye-in-hand":
                point = np.array([0.0, 0.0, AHEAD_M, 1.0])
                apart = flange @ found.X @ point - true @ X_true @ point
            else:
                apart = (found.X @ se3.inverse(X_true) @ true - flange)[:, 3]
            below.append(bool(np.linalg.norm(apart[:3]) < length))
        yield below[0], below[1]


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_most_errors_are_below_what_is_stated(setup: str) -> None:
    below = np.sum(list(errors(setup)), axis=0)
    assert below[0] >= LEAST, "by the arm as configured"
    assert below[1] >= LEAST, "by the corrected arm"


def test_the_length_is_that_of_errors_drawn_from_the_joint_covariance() -> None:
    rng = np.random.default_rng(3)
    cell = world(rng, 2e-4, "exact", "exact")
    found, arm = adjusted(*capture(rng, cell, "small"))
    subject = task_accuracy(found, arm, Q_TASK, AHEAD_M)
    part = arm_numbers(found)
    joint = np.block(
        [[found.cov, found.cross[:, part]], [found.cross[:, part].T, found.cov_numbers[part, part]]]
    )
    s = np.sqrt(np.diag(joint))
    values, vectors = np.linalg.eigh(joint / np.outer(s, s))
    drawn = (s[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))) @ rng.normal(size=(len(s), 4000))
    point = np.array([0.0, 0.0, AHEAD_M, 1.0])
    flange = arm.model.base.flange(Q_TASK[None])[0]
    still = flange @ found.X @ point
    columns = arm_columns(arm, Q_TASK[None])[0]
    moved = flange @ se3.exp((columns @ drawn[6:]).T) @ found.X @ se3.exp(drawn[:6].T) @ point
    length = float(np.quantile(np.linalg.norm((moved - still)[:, :3], axis=1), 0.95))
    assert subject.corrected95 == pytest.approx(length, rel=0.05)
    assert subject.configured95 > subject.corrected95


def test_a_root_follows_the_covariance_though_its_axes_do_not() -> None:
    """Rounding that turns the axes of equal variances, as another processor's would, leaves the draws."""
    turned = np.array([[2.0, 1e-13, 0.0], [1e-13, 2.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(symmetric_root(turned), np.diag([2.0, 2.0, 1.0]) ** 0.5, rtol=0.0, atol=1e-12)
