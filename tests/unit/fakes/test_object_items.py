"""What the camera of the object face makes of items, beside the detector that looks at pictures."""

import numpy as np
import pytest

from fakes.frames.stereo import stereo_depth
from fakes.object.item_detection import Look
from fakes.world.camera.truth import CameraTruth, StereoTruth
from tests.kit.item_scene import CAMERA, SIZE, T_BASE_CAMERA, Scene
from tests.kit.object_items import items_of_seconds

SCALE = 1.05
EXACT = StereoTruth(noise_px=0.0, steps=64, focal_px=1e6)  # by its disparity, its scale is unknown as any
FINE = {"steps": 64, "noise_px": 0.2}  # noise over many steps, and over millimetres: no pattern
HEIGHT_M = 0.03  # of the items of the scenario


def test_depth_of_a_wrong_scale_shifts_items_along_their_sights_as_in_a_picture() -> None:
    normal, exact = items_of_seconds(10, stereo=StereoTruth(scale=1.0, **FINE))
    _, scaled = items_of_seconds(10, stereo=StereoTruth(scale=SCALE, **FINE))
    assert len(exact) > 5
    for a, b in zip(exact, scaled, strict=True):
        # The pattern of told millimetres does not scale. It is below 0.1 mm here, and the scale does 1.5 mm.
        assert b.height_m == pytest.approx(SCALE * a.height_m, abs=1e-4)
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
    normal, items = items_of_seconds(10, stereo=EXACT)
    slant = np.array([np.linalg.norm(i.point - (i.point @ normal) * normal) for i in items])
    says = np.array([i.sigma_m for i in items])
    assert (np.diff(says[np.argsort(slant)]) > -1e-9).all()
    assert says.max() > 1.05 * says.min()


# By steps of half a pixel, which are 9 mm of depth, a level face scatters more than by noise.
@pytest.mark.parametrize(
    ("coarse", "fine", "most_m"),
    [({}, {"focal_px": 880.0}, 1e-3), ({"steps": 2}, {"steps": 32}, 3e-3)],
)
def test_heights_scatter_more_by_a_pair_with_coarser_disparity(
    coarse: dict[str, float], fine: dict[str, float], most_m: float
) -> None:
    off, says = [], []
    for pair in (coarse, fine):
        _, items = items_of_seconds(40, stereo=StereoTruth(**pair))
        assert len(items) > 60
        off.append(np.std([item.height_m - HEIGHT_M for item in items]))
        says.append(np.mean([i.sigma_m for i in items]))
    assert 1e-4 < off[1] < 0.8 * off[0] < most_m
    assert says[1] < says[0]


@pytest.mark.parametrize("pair", [{}, {"focal_px": 880.0}, {"steps": 2}])
def test_a_height_scatters_as_that_of_the_detector_in_pictures(pair: dict[str, float]) -> None:
    stereo, scene = StereoTruth(**pair), Scene(noise_once=True)
    rng, detector = np.random.default_rng(3), scene.detector()
    heights, says, offs = [], [], []
    for _ in range(24):
        x, y, yaw = rng.uniform(-0.3, 0.3), rng.uniform(-0.7, -0.5), rng.uniform(0.0, np.pi)
        colour, depth = scene.picture([(x, y, yaw)])
        heights += [item.height_m for item in detector.find(colour, stereo_depth(depth, stereo, rng))]
        middle = T_BASE_CAMERA.inv().apply([x, y, SIZE[2]])
        look = Look(None, camera_of(stereo), CAMERA, 1, 1)
        says.append(look.height_sigma_m(middle, scene.normal, SIZE))
        offs.append(look.height_off_m(middle, scene.normal, SIZE, scene.offset_m))
    assert len(heights) > 20
    assert np.std(heights, ddof=1) == pytest.approx(np.hypot(np.mean(says), np.std(offs, ddof=1)), rel=0.35)


@pytest.mark.parametrize("pair", [{}, {"steps": 2}, {"noise_px": 0.02}, {"steps": 2, "noise_px": 0.02}])
def test_what_steps_do_to_a_whole_face_is_alike_in_all_pictures(pair: dict[str, float]) -> None:
    """A level face and the belt beside it, in drawn depth."""
    stereo, rng = StereoTruth(**pair), np.random.default_rng(5)
    h, w, edge = 48, 64, 8
    heights, says, offs = [], [], []
    for depth_m in rng.uniform(0.7, 0.9, 300):
        depth = np.full((h + 2 * edge, 2 * w + 3 * edge), 1000.0 * depth_m, np.float32)
        depth[:, w + edge :] += 30.0
        told = stereo_depth(depth, stereo, rng)[edge : edge + h].astype(float)
        heights.append(told[:, -w:].mean() - told[:, : w - edge].mean())
        size = w * depth_m / CAMERA.K[0], h * depth_m / CAMERA.K[1]
        look = Look(None, camera_of(stereo), CAMERA, 1, 1)
        middle, normal = np.array([0.0, 0.0, depth_m]), np.array([0.0, 0.0, 1.0])
        says.append(look.height_sigma_m(middle, normal, size))
        # The belt is here behind the face, and its height is told less than it is.
        offs.append(look.height_off_m(middle, normal, size, depth_m + 0.03))
    left = 1e-3 * (np.array(heights) - 30.0) + np.array(offs)
    assert np.std(left, ddof=1) == pytest.approx(np.sqrt(np.mean(np.square(says))), rel=0.25)
    assert np.std(left) < np.std(heights) * 1e-3


def camera_of(stereo: StereoTruth) -> CameraTruth:
    told = {"K": list(CAMERA.K), "nominal": [0.0] * 6, "T_base_camera": [0.0] * 6}
    return CameraTruth.model_validate({**told, "stereo": stereo.model_dump()})
