"""Items by the camera's pose and lens: how far errors of these move them, and which lens belongs to it."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.adjustment.lens_terms import lens_prior, moved_camera
from calibration.belt.placing import NUMBERS, POSE, camera_cov, off_by_camera
from calibration.hand_eye import se3
from cell.devices import Intrinsics
from cell.poses import Array
from tests.kit.items_by_lens import placed_items

LENS = Intrinsics(1280, 800, (802.4, 801.7, 644.2, 396.8), (0.021, -0.043, 0.0006, -0.0004, 0.0))


def test_derivatives_are_those_of_the_sight_that_meets_the_level() -> None:
    T = RigidTransform.from_components([0.1, -0.2, 0.9], Rotation.from_rotvec([3.0, 0.1, 0.2]))
    items = np.array([[0.3, -0.1, 0.05], [-0.25, 0.05, 0.02], [0.1, -0.4, 0.03]])
    seen = np.ascontiguousarray(T.inv().apply(items))
    pixels, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), LENS.matrix, np.array(LENS.dist))
    pixels = pixels.reshape(-1, 2)

    def placed(numbers: Array) -> Array:
        pose = RigidTransform.from_matrix(T.as_matrix() @ se3.exp(numbers[:POSE]))
        lens = moved_camera(LENS, numbers[POSE:])
        xy = cv2.undistortPointsIter(
            pixels.reshape(-1, 1, 2), lens.matrix, np.array(lens.dist), None, None, (3, 100, 1e-14)
        )
        sights = pose.rotation.apply(np.column_stack([xy.reshape(-1, 2), np.ones(len(items))]))
        reach = (items[:, 2] - pose.translation[2]) / sights[:, 2]
        return np.asarray((pose.translation + sights * reach[:, None])[:, :2])

    step = 1e-5
    ways = step * np.eye(NUMBERS)
    by_steps = np.stack([(placed(way) - placed(-way)) / (2.0 * step) for way in ways], axis=2)
    assert off_by_camera(items, T, LENS) == pytest.approx(by_steps, abs=1e-5)


def test_items_lie_by_the_lens_that_was_found_with_the_pose_as_sure_as_is_stated() -> None:
    """The camera tells its focal length 0.3 % and its centre 5 px wrong."""
    runs = [placed_items(seed) for seed in range(3)]
    off = {name: np.concatenate([run[name].off for run in runs]) for name in runs[0]}
    rms = {name: float(np.sqrt(np.mean(np.sum(of**2, axis=1)))) for name, of in off.items()}
    inside = {name: float(np.mean([run[name].inside for run in runs])) for name in runs[0]}
    assert rms["told"] > 1e-3
    assert rms["found"] < 0.1 * rms["told"]
    assert inside["pose"] < 0.1, "the pose's covariance alone does not have the lens in it"
    assert inside["told"] > 0.9
    assert inside["found"] > 0.8  # of 24 items of three calibrations; bench.items_by_lens has more
    stated = np.concatenate([np.trace(run["found"].cov, axis1=1, axis2=2) for run in runs])
    assert np.sqrt(np.mean(stated)) < 3.0 * rms["found"]


def test_only_a_lens_that_was_not_found_with_the_pose_is_as_its_maker_knows_it() -> None:
    cov, together = 1e-8 * np.eye(POSE), 1e-7 * np.eye(NUMBERS)
    assert camera_cov(cov, together, None) is together
    prior = lens_prior({"f": 0.01})
    told = camera_cov(cov, together, prior)
    assert np.sqrt(np.diag(told)) == pytest.approx([*[1e-4] * POSE, *prior.sigma()])
    assert prior.focal == 0.01
    assert np.diag(camera_cov(cov, None, None)) == pytest.approx([*[1e-8] * POSE, *[0.0] * 8])
