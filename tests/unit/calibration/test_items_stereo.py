"""Items are found, and placed by colour, where depth has the holes, edges and noise of a stereo pair."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from fakes.frames.stereo import stereo_depth
from fakes.world.camera.truth import StereoTruth as Stereo
from tests.kit.item_scene import SIZE, T_BASE_CAMERA, Scene

PLACES = [(x, y, yaw) for x, yaw in ((-0.2, 0.3), (0.05, 1.2), (0.3, 2.4)) for y in (-0.7, -0.5)]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(noise_once=True)


@pytest.mark.parametrize(
    "stereo",
    [
        Stereo(),
        Stereo(holes=0.1),
        Stereo(holes=0.3),
        Stereo(scale=1.02),
        Stereo(noise_px=0.2),
        Stereo(holes=0.3, noise_px=0.2, scale=0.98),
    ],
    ids=["plain", "10 % holes", "30 % holes", "2 % scale", "0.2 px noise", "all"],
)
def test_an_item_is_where_it_says_within_its_uncertainty(scene: Scene, stereo: Stereo) -> None:
    rng = np.random.default_rng(7)
    detector = scene.detector()
    off, says = [], []
    for x, y, yaw in PLACES:
        colour, depth = scene.picture([(x, y, yaw)])
        (item,) = detector.find(colour, stereo_depth(depth, stereo, rng))
        off.append(float(np.linalg.norm(T_BASE_CAMERA.apply(item.point)[:2] - [x, y])))
        says.append(item.sigma_m)
        assert T_BASE_CAMERA.apply(item.point)[2] == pytest.approx(SIZE[2], abs=0.003)
    assert np.sqrt(np.mean(np.square(off))) <= 0.5e-3
    assert np.mean(np.array(off) <= 3.0 * np.array(says)) == 1.0


def test_a_height_that_nobody_knows_well_makes_a_slanted_sight_less_sure(scene: Scene) -> None:
    rng = np.random.default_rng(7)
    detector = scene.detector()
    colour, depth = scene.picture([(0.3, -0.5, 0.3)])
    (drawn,), (seen,) = (
        detector.find(colour, depth),
        detector.find(colour, stereo_depth(depth, Stereo(noise_px=0.3), rng)),
    )
    assert seen.sigma_m > drawn.sigma_m


def test_an_empty_belt_under_noise_shows_no_item(scene: Scene) -> None:
    rng = np.random.default_rng(7)
    detector = scene.detector()
    colour, depth = scene.picture([])
    assert detector.find(colour, stereo_depth(depth, Stereo(noise_px=0.2, holes=0.1), rng)) == ()


@pytest.mark.parametrize(
    ("place", "stereo", "seed"),
    [((0.3, -0.5, 0.3), Stereo(holes=0.1), [3, 10]), ((0.3, -0.5, 0.3), Stereo(noise_px=0.2), [0, 10])],
    ids=["a hole at the side", "a noisy side"],
)
def test_a_side_that_depth_takes_for_the_face_moves_it_no_more(
    scene: Scene, place: tuple[float, float, float], stereo: Stereo, seed: list[int]
) -> None:
    colour, depth = scene.picture([place])
    (item,) = scene.detector().find(colour, stereo_depth(depth, stereo, np.random.default_rng(seed)))
    off = float(np.linalg.norm(T_BASE_CAMERA.apply(item.point)[:2] - place[:2]))
    assert off < min(0.5e-3, 3.0 * item.sigma_m)


@pytest.mark.parametrize("x", [-0.45, 0.45])
def test_a_side_in_another_shade_is_no_part_of_the_face_at_the_edge_of_the_picture(
    scene: Scene, x: float
) -> None:
    rng = np.random.default_rng(3)
    detector = scene.detector()
    for y, yaw in [(y, yaw) for y in (-0.75, -0.6, -0.45) for yaw in (0.0, 0.4, 1.2, 2.4)]:
        colour, depth = scene.picture([(x, y, yaw)])
        for item in detector.find(colour, stereo_depth(depth, Stereo(holes=0.05), rng)):
            off = float(np.linalg.norm(T_BASE_CAMERA.apply(item.point)[:2] - [x, y]))
            assert off < min(1e-3, 3.0 * item.sigma_m), (y, yaw)


@pytest.mark.parametrize(
    ("middle", "size"),
    [((0.02, 0.01), (0.03, 0.03)), ((0.02, 0.0), (0.04, 0.06)), ((-0.02, 0.0), (0.04, 0.06))],
    ids=["a corner", "an end", "the other end"],
)
def test_a_hole_that_hides_much_of_a_face_from_depth_moves_it_no_more(
    scene: Scene, middle: tuple[float, float], size: tuple[float, float]
) -> None:
    x, y, yaw = 0.05, -0.6, 0.3
    colour, depth = scene.picture([(x, y, yaw)])
    told = stereo_depth(depth, Stereo(), np.random.default_rng(7))
    hide(scene, told, (x, y, yaw), middle, size)
    (item,) = scene.detector().find(colour, told)
    off = float(np.linalg.norm(T_BASE_CAMERA.apply(item.point)[:2] - [x, y]))
    assert off < min(0.5e-3, 3.0 * item.sigma_m)
    assert item.size_m == pytest.approx(SIZE[:2], abs=1e-3)


def test_a_face_that_a_hole_parts_in_two_is_left_to_another_picture(scene: Scene) -> None:
    x, y, yaw = 0.05, -0.6, 0.3
    colour, depth = scene.picture([(x, y, yaw)])
    told = stereo_depth(depth, Stereo(), np.random.default_rng(7))
    hide(scene, told, (x, y, yaw), (0.0, 0.0), (0.03, 0.08))
    assert scene.detector().find(colour, told) == ()


@pytest.mark.parametrize(
    ("middle", "size"),
    [((0.035, 0.0), (0.04, 0.06)), ((0.012, 0.0), (0.036, 0.06))],
    ids=["over the gap", "up to the gap"],
)
def test_a_hole_beside_another_item_leaves_both_where_they_are(
    scene: Scene, middle: tuple[float, float], size: tuple[float, float]
) -> None:
    places = [(0.01, -0.6, 0.0), (0.08, -0.6, 0.0)]
    colour, depth = scene.picture(places)
    told = stereo_depth(depth, Stereo(), np.random.default_rng(7))
    hide(scene, told, places[0], middle, size)
    items = sorted(scene.detector().find(colour, told), key=lambda item: T_BASE_CAMERA.apply(item.point)[0])
    assert len(items) == 2
    for item, (x, y, _) in zip(items, places, strict=True):
        assert float(np.linalg.norm(T_BASE_CAMERA.apply(item.point)[:2] - [x, y])) < 0.5e-3


def hide(
    scene: Scene,
    depth: NDArray[np.uint16],
    place: tuple[float, float, float],
    middle: tuple[float, float],
    size: tuple[float, float],
) -> None:
    """No ``depth`` of a rectangle of ``size`` (m) about ``middle`` (m) of the face at ``place``."""
    turn = RigidTransform.from_components([*place[:2], SIZE[2]], Rotation.from_euler("z", place[2]))
    sights = scene.rays.astype(float)
    height = scene.offset_m + SIZE[2]
    on_face = T_BASE_CAMERA.apply((sights * (height / (sights @ scene.normal))[..., None]).reshape(-1, 3))
    own = turn.inv().apply(on_face)[:, :2].reshape(*depth.shape, 2)
    depth[np.all(np.abs(own - middle) < 0.5 * np.array(size), axis=-1)] = 0
