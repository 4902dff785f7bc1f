"""Whether given intrinsics fit the images, and what they are when they do not."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.hand_eye.views import CornerSet
from calibration.intrinsics import check_intrinsics, estimate_intrinsics, select_views
from tests.kit.hand_eye_scene import CAMERA, POINTS, cone_views, make_scene


@pytest.fixture
def subject() -> list[CornerSet]:
    rng = np.random.default_rng(8)
    scene = make_scene(8, count=24, views=[*cone_views(rng, 12), *cone_views(rng, 12, 0.7)], px=0.15)
    return [CornerSet(POINTS, uv, np.ones(54)) for uv in scene.corners]


def test_true_intrinsics_fit(subject: list[CornerSet]) -> None:
    check = check_intrinsics(subject, CAMERA)
    assert check is not None
    assert check.fits
    assert check.rms_given_px == pytest.approx(0.15 * np.sqrt(2), rel=0.08)


@pytest.mark.parametrize(
    "wrong",
    [
        replace(CAMERA, dist=()),
        replace(CAMERA, K=(927.0, 932.0, 640.0, 400.0)),
        replace(CAMERA, K=(450.0, 452.5, 320.0, 200.0)),
    ],
    ids=["no distortion", "focal length 3 per cent off", "for half the resolution"],
)
def test_wrong_intrinsics_do_not_fit(subject: list[CornerSet], wrong: object) -> None:
    check = check_intrinsics(subject, wrong)  # type: ignore[arg-type]
    assert check is not None
    assert not check.fits


def test_estimated_intrinsics_are_right_within_their_uncertainty(subject: list[CornerSet]) -> None:
    found = estimate_intrinsics(subject, 1280, 800)
    assert found is not None
    assert found.useful
    assert np.all(np.abs(np.array(found.camera.K) - CAMERA.K) < 4.5 * found.sigma_K + 1.0)


def test_a_few_views_tell_nothing(subject: list[CornerSet]) -> None:
    assert check_intrinsics(subject[:3], CAMERA) is None
    assert estimate_intrinsics(subject[:2], 1280, 800) is None


@pytest.mark.parametrize("bad", [[3], [3, 11], [0, 3, 7, 11, 20]])
def test_a_minority_of_bad_views_does_not_speak_against_true_intrinsics(
    subject: list[CornerSet], bad: list[int]
) -> None:
    for k in bad:
        subject[k] = replace(subject[k], corners=subject[k].corners + np.array([120.0, 0.0]))
    check = check_intrinsics(subject, CAMERA)
    assert check is not None
    assert check.fits
    assert set(check.left_out) <= set(bad)


def test_steep_views_that_alone_show_a_wrong_lens_are_kept() -> None:
    rng = np.random.default_rng(3)
    views = [*cone_views(rng, 10, 0.25), *cone_views(rng, 3, 0.9)]
    scene = make_scene(3, count=13, views=views, px=0.05)
    steep = [CornerSet(POINTS, uv, np.ones(54)) for uv in scene.corners]
    check = check_intrinsics(steep, replace(CAMERA, K=(960.0, 965.0, 640.0, 400.0)))
    assert check is not None
    assert not check.fits
    assert check.left_out == ()


def test_long_sets_are_thinned_evenly(subject: list[CornerSet]) -> None:
    chosen = select_views(subject * 10)
    assert len(chosen) == 30
    assert chosen[0] is subject[0]
    assert chosen[-1] is subject[-1]


def test_points_in_space_need_a_guess(subject: list[CornerSet]) -> None:
    lifted = [
        CornerSet(v.points + np.outer(np.arange(54) % 2, [0, 0, 0.01]), v.corners, v.count) for v in subject
    ]
    assert estimate_intrinsics(lifted, 1280, 800) is None
