"""Arms whose errors are so large that products of them move the flange by more than its noise."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.adjustment import hand_eye
from calibration.adjustment.arm_about import ArmAbout, arm_with
from calibration.adjustment.arm_accuracy import arm_columns, corrected_arm, on_corrected_arm, predicted_flange
from calibration.adjustment.arm_by_tracker import seen_arm
from calibration.adjustment.arm_terms import joints_to_average, reference_joints
from calibration.adjustment.gauge import apart
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.touch import Touches, seen_touch
from calibration.adjustment.unknowns import TARGET_BLOCK, ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Solution, solve
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array, adjoint
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, POINTS, World, capture, capture_eye_to_hand, world

JOINTS = reference_joints(ARM.joint_limits, 4, seed=8)
KNOWN = ArmKnown(MODEL, JOINTS, ARM.joint_limits)
SIGMA = np.repeat([3e-3, 3e-5], [len(MODEL.names), 27])  # links (m, rad), gears and sag
NUMBERS = np.random.default_rng(5).normal(size=len(SIGMA)) * SIGMA


def solved(seed: int, arm_m: float, setup: str = "eye-in-hand") -> tuple[World, ArmKnown, Adjusted]:
    rng = np.random.default_rng([seed, 6])
    cell = world(rng, arm_m, "exact", "exact")
    if setup == "eye-in-hand":
        measured, Q = capture(rng, cell, "few branches")
    else:
        measured, Q, _ = capture_eye_to_hand(rng, cell)
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    known = ArmKnown(MODEL, Q, ARM.joint_limits)
    return cell, known, adjust(measured, first, CAMERA, known)


def project(C: Array, points: Array, camera: Intrinsics) -> Array:
    uv, _ = cv2.projectPoints(
        points, cv2.Rodrigues(C[:3, :3])[0], C[:3, 3], camera.matrix, np.array(camera.dist)
    )
    return np.asarray(uv.reshape(-1, 2))


def test_the_flange_is_that_of_the_corrected_arm_after_the_best_base_and_flange() -> None:
    subject = ArmAbout(KNOWN, NUMBERS)
    Q = joints_to_average(ARM.joint_limits)
    model, moved = MODEL.base.flange(Q), subject.motion(Q)
    left = apart(model, model @ moved)
    np.testing.assert_allclose(se3.log(moved), left, atol=1e-5)
    base, flange = subject.ends
    own = base @ MODEL.base.flange(JOINTS) @ subject.motion(JOINTS) @ flange
    arm, values = arm_with(NUMBERS, KNOWN)
    np.testing.assert_allclose(own, arm.chain(values).flange(JOINTS), atol=1e-12)
    assert np.abs(left[:, :3]).max() > 3e-3, "as large as its numbers"


def test_derivatives_are_those_of_the_corrected_arm() -> None:
    """But for one base and one flange of all joints, which follow what they leave as well."""
    subject, step = ArmAbout(KNOWN, NUMBERS), 1e-5
    columns, motion = subject.columns(JOINTS), subject.motion(JOINTS)
    ends = np.concatenate(
        [adjoint(se3.inverse(subject.flange(JOINTS))), np.tile(np.eye(6), (16, 1, 1))], axis=2
    )

    def own(moved: Array) -> Array:
        A, b = ends.reshape(-1, 12), moved.ravel()
        return np.asarray(b - A @ np.linalg.lstsq(A, b, rcond=None)[0])

    configured = arm_columns(KNOWN, JOINTS)
    for k in (*range(len(MODEL.names)), len(MODEL.names) + 7, len(NUMBERS) - 1):
        there = ArmAbout(KNOWN, NUMBERS + step * np.eye(len(NUMBERS))[k]).motion(JOINTS)
        moved = own(se3.log(se3.inverse(motion) @ there) / step)
        np.testing.assert_allclose(own(columns[:, :, k]), moved, atol=1e-5)
        if np.abs(moved).max() > 1e-6:  # the others move base or flange alone
            assert np.abs(own(configured[:, :, k]) - moved).max() > 3e-5


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_an_answer_on_the_corrected_arm_is_that_arm(setup: str) -> None:
    """Camera and target meet alike on the arm as configured with its errors, and on the corrected arm."""
    _, known, found = solved(3, 4e-3, setup)
    assert found.arm_at.any()
    arm, values = corrected_arm(found, known)
    X, _ = on_corrected_arm(found, known)
    T, _ = predicted_flange(found, known, known.Q)
    flange = arm.chain(values).flange(known.Q)
    if setup == "eye-in-hand":
        between = (T @ found.X) @ se3.inverse(flange @ X)
    else:
        between = (se3.inverse(T) @ found.X) @ se3.inverse(se3.inverse(flange) @ X)
    np.testing.assert_allclose(between, np.broadcast_to(between[0], between.shape), atol=1e-9)


def test_a_touch_test_takes_camera_and_arm_as_they_were_found() -> None:
    """The tool's point stands where the corrected arm has it, so nothing is off."""
    _, known, found = solved(3, 4e-3)
    arm, values = corrected_arm(found, known)
    X, _ = on_corrected_arm(found, known)
    flange = arm.chain(values).flange(JOINTS[:4])
    look, tool = flange[0], np.array([0.0, 0.0, 0.18])
    C = se3.exp(np.array([0.0, 0.0, 0.0, 0.15, -0.1, 0.0]))
    C[:3, 3] = [0.0, 0.0, 0.5] - C[:3, :3] @ POINTS.mean(axis=0)
    seen = found.shape.moved(POINTS, found.numbers[found.blocks[TARGET_BLOCK]])
    view = CornerSet(POINTS, project(C, seen, found.camera), np.ones(len(POINTS)))
    places = (se3.inverse(look @ X @ C) @ flange @ np.append(tool, 1.0))[:, :3]
    points = places.copy()
    for _ in range(3):  # as designed, where they are printed there
        points += places - found.shape.moved(points, found.numbers[found.blocks[TARGET_BLOCK]])
    of = Touches(JOINTS[0], JOINTS[:4], view, points, 0.0, tool, 1e-4, 1e-4, 3e-5)
    subject = seen_touch(of, found, known, 0.2)
    np.testing.assert_allclose(subject.off, 0.0, atol=1e-6)


def test_what_a_tracker_tells_of_an_arm_with_errors_of_millimetres_is_so_of_the_true_one() -> None:
    """Without noise: within less than one of its standard deviations, in all numbers together."""
    arm, values = arm_with(NUMBERS, KNOWN)
    known = replace(KNOWN, Q=reference_joints(ARM.joint_limits, 6, seed=3))
    places = (arm.chain(values).flange(known.Q) @ [0.04, -0.05, 0.09, 1.0])[:, :3]
    count = len(places)
    subject = seen_arm(known, places, np.zeros(count, dtype=np.int64), np.full(count, 3e-5))
    size = np.repeat([2e-4, 2e-5], [len(MODEL.names), 27])  # of the numbers, for a sound inverse
    off = size * (subject.pull - subject.information @ NUMBERS)
    scaled = size[:, None] * subject.information * size
    assert float(off @ np.linalg.pinv(scaled, rcond=1e-9, hermitian=True) @ off) < 0.1


def test_products_of_errors_of_millimetres_are_no_errors_of_the_answer() -> None:
    """The products of 4 mm and 6 mrad are 0.1 mm: as unknowns that are linear they were errors of X."""
    squared = []
    for seed in range(4):
        cell, _, found = solved(seed, 4e-3)
        e = se3.log(se3.inverse(found.X) @ cell.X)
        squared.append(float(e @ np.linalg.solve(found.cov, e)))
    assert np.mean(squared) < 11.3


def test_an_arm_of_a_fraction_of_a_millimetre_stays_linear() -> None:
    assert not solved(0, 2e-4)[2].arm_at.any()


def test_an_answer_that_still_moves_in_the_last_round_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """And is the one of the arm about which it was solved, not of one that no step was taken about."""
    assert solved(3, 4e-3)[2].settled
    monkeypatch.setattr(hand_eye, "_ROUNDS", 1)
    subject = solved(3, 4e-3)[2]
    assert not subject.settled
    assert not subject.arm_at.any()
