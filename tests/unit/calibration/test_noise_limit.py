"""Attitudes that scatter beyond what an arm in working order has are believed where that predicts better."""

import numpy as np
import pytest

from calibration.hand_eye import se3
from calibration.hand_eye.noise import MOST
from calibration.hand_eye.noise_limit import fit_within_limits, prediction_error
from calibration.hand_eye.robust import robust_fit
from calibration.hand_eye.solution import prepare
from tests.kit.hand_eye_scene import CAMERA, X_TRUE, make_scene


def test_the_one_that_predicts_left_out_poses_better_is_taken() -> None:
    errors = []
    for seed in range(8):
        problem = prepare(make_scene(seed, count=16, flange_r=5e-3).measurements(), CAMERA)
        held, free = robust_fit(problem, {}), robust_fit(problem, {}, most={})
        subject = fit_within_limits(problem, {})
        assert subject.noise.implausible == ("sigma_flange_r",)
        better = min((held, free), key=lambda fit: prediction_error(problem, fit))
        assert subject.noise.sigma == better.noise.sigma
        off = [np.linalg.norm((fit.lin.at.X - X_TRUE.as_matrix())[:3, 3]) for fit in (held, free, subject)]
        errors.append(off)
    held_mm, free_mm, chosen_mm = 1e3 * np.sqrt(np.mean(np.square(errors), axis=0))
    assert free_mm < held_mm, "attitudes that truly scatter weigh too much at the limit"
    assert chosen_mm < held_mm


def test_within_the_limit_there_is_nothing_to_choose() -> None:
    problem = prepare(make_scene(1, count=16).measurements(), CAMERA)
    subject, plain = fit_within_limits(problem, {}), robust_fit(problem, {})
    assert subject.noise == plain.noise
    assert np.array_equal(subject.lin.at.X, plain.lin.at.X)
    assert subject.noise.implausible == ()
    assert subject.noise.most == MOST


def test_an_observation_that_is_not_used_counts_by_how_far_off_it_is() -> None:
    scene = make_scene(3, count=12)
    scene.flange[4] = scene.flange[4] * (se3.transforms(se3.exp(np.r_[0.0, 0.0, 0.05, np.zeros(3)])))
    problem = prepare(scene.measurements(), CAMERA)
    fit = robust_fit(problem, {})
    assert np.flatnonzero(~fit.used).tolist() == [4]
    good = prediction_error(problem.take(fit.used), robust_fit(problem.take(fit.used), {}))
    assert prediction_error(problem, fit) == pytest.approx((11 * good + 0.05) / 12, rel=0.05)
