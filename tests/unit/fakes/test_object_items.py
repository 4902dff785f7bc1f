"""What the camera of the object face makes of items, beside the detector that looks at pictures."""

import numpy as np
import pytest

from fakes.frames.stereo import stereo_depth
from fakes.world.camera.truth import StereoTruth
from tests.kit.item_scene import Scene
from tests.kit.object_items import items_of_seconds

SCALE = 1.05


def test_depth_of_a_wrong_scale_shifts_items_along_their_sights_as_in_a_picture() -> None:
    normal, exact = items_of_seconds(10, stereo=StereoTruth(scale=1.0))
    _, scaled = items_of_seconds(10, stereo=StereoTruth(scale=SCALE))
    assert len(exact) > 5
    for a, b in zip(exact, scaled, strict=True):
        assert b.height_m == pytest.approx(SCALE * a.height_m)
        # Both have the same noise, of 0.3 mm beside the sight: a thousandth of the shift.
        sight = a.point / (a.point @ normal)
        assert b.point - a.point == pytest.approx((b.height_m - a.height_m) * sight, abs=5e-6)

    # The detector, in a picture of a box of 6 cm: its height is found to a tenth of a millimetre.
    scene = Scene()
    colour, depth = scene.picture([(0.35, -0.6, 0.4)], size=(0.08, 0.06, 0.06))
    (a,), (b,) = [
        scene.detector().find(
            colour, stereo_depth(depth, StereoTruth(scale=scale, noise_px=0.0), np.random.default_rng(1))
        )
        for scale in (1.0, 1.03)
    ]
    shift = 0.03 * 0.06 * a.point / (a.point @ scene.normal)
    assert b.point - a.point == pytest.approx(shift, rel=0.1)


def test_the_further_off_the_middle_the_less_sure_is_an_item_by_stereo() -> None:
    normal, items = items_of_seconds(10, stereo=StereoTruth(scale=1.0))
    slant = np.array([np.linalg.norm(i.point - (i.point @ normal) * normal) for i in items])
    says = np.array([i.sigma_m for i in items])
    assert (np.diff(says[np.argsort(slant)]) > -1e-9).all()
    assert says.max() > 1.05 * says.min()
