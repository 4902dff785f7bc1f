"""Items in rendered pictures: where they are, how they lie, and which are not reported."""

import numpy as np
import pytest

from calibration.items.by_colour import silhouette
from cell.errors import CellError
from tests.kit.item_scene import BELT_GREY, T_BASE_CAMERA, Scene

PLACES = [(x, y, yaw) for x, yaw in ((-0.2, 0.3), (0.05, 1.2), (0.3, 2.4)) for y in (-0.7, -0.5)]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(noise_once=True)


@pytest.mark.parametrize("speed_m_s", [0.0, 0.3])
def test_an_items_middle_is_found_anywhere_in_the_picture_at_any_speed(
    scene: Scene, speed_m_s: float
) -> None:
    detector = scene.detector()
    errors, stated = [], []
    for x, y, yaw in PLACES:
        (item,) = detector.find(*scene.picture([(x, y, yaw)], speed_m_s))
        errors.append(T_BASE_CAMERA.apply(item.point) - [x, y, 0.03])
        stated.append(item.sigma_m)
    assert np.abs(errors).max() < 0.4e-3
    assert np.sqrt(np.mean(np.square(errors), axis=0))[:2].max() < 1.5 * np.mean(stated)


def test_a_side_that_is_seen_as_a_narrow_strip_does_not_move_the_middle(scene: Scene) -> None:
    detector, off = scene.detector(), []
    for x in np.linspace(-0.06, 0.18, 9):  # below the camera, where a side is 0 to 5 pixels wide
        (item,) = detector.find(*scene.picture([(x, -0.62, 0.1)]))
        off.append(T_BASE_CAMERA.apply(item.point)[:2] - [x, -0.62])
    assert np.abs(off).max() < 0.15e-3
    assert np.abs(np.mean(off, axis=0)).max() < 0.06e-3


def test_a_side_that_is_seen_does_not_draw_the_middle_towards_the_camera(scene: Scene) -> None:
    detector, drawn = scene.detector(), []
    for x in (-0.25, 0.45):
        for y in (-0.68, -0.5):
            (item,) = detector.find(*scene.picture([(x, y, 0.05)]))
            drawn.append((T_BASE_CAMERA.apply(item.point)[0] - x) * np.sign(0.1 - x))
    assert abs(np.mean(drawn)) < 0.06e-3


@pytest.mark.parametrize(("x", "yaw"), [(-0.25, 0.06), (0.4, 1.2)])
def test_a_tall_items_middle_is_found_where_its_side_is_seen_at_a_slant(
    scene: Scene, x: float, yaw: float
) -> None:
    size = (0.06, 0.04, 0.075)
    (item,) = scene.detector().find(*scene.picture([(x, -0.55, yaw)], size=size))
    assert T_BASE_CAMERA.apply(item.point) == pytest.approx([x, -0.55, 0.075], abs=0.7e-3)


def test_an_item_with_another_close_beside_it_is_less_sure(scene: Scene) -> None:
    detector = scene.detector()
    (alone,) = detector.find(*scene.picture([(-0.1, -0.6, 0.0)]))
    beside = detector.find(*scene.picture([(-0.165, -0.6, 0.0), (-0.1, -0.6, 0.0)]))
    assert beside
    for item in beside:
        x = T_BASE_CAMERA.apply(item.point)[0]
        assert item.sigma_m > 2.0 * alone.sigma_m
        assert min(abs(x + 0.165), abs(x + 0.1)) < 3.0 * item.sigma_m


@pytest.mark.parametrize("share", [-0.008, 0.008])
def test_depth_that_is_off_by_a_share_of_the_distance_moves_neither_place_nor_height(
    scene: Scene, share: float
) -> None:
    x, y = -0.25, -0.5
    colour, depth = scene.picture([(x, y, 0.3)])
    dither = np.random.default_rng(2).uniform(-0.5, 0.5, depth.shape)  # not to be rounded twice
    off = np.round(depth * (1.0 + share) + dither).astype(np.uint16)
    (item,) = scene.detector().find(colour, off)
    assert T_BASE_CAMERA.apply(item.point) == pytest.approx([x, y, 0.03], abs=0.4e-3)


def test_an_item_says_how_it_lies_how_large_and_how_high_it_is(scene: Scene) -> None:
    (item,) = scene.detector().find(*scene.picture([(0.1, -0.6, 0.7)]))
    axis = T_BASE_CAMERA.rotation.apply(item.axis)
    off = (np.arctan2(axis[1], axis[0]) - 0.7 + np.pi / 2) % np.pi - np.pi / 2
    assert abs(off) < 0.03
    assert item.size_m == pytest.approx((0.06, 0.04), abs=0.0015)
    assert item.height_m == pytest.approx(0.03, abs=0.0005)


def test_all_items_in_a_picture_are_found(scene: Scene) -> None:
    found = scene.detector().find(*scene.picture(PLACES))
    at = np.sort([T_BASE_CAMERA.apply(item.point)[0] for item in found])
    assert at == pytest.approx(np.sort([x for x, _, _ in PLACES]), abs=1e-3)


def test_an_item_cut_by_the_rim_of_the_picture_is_not_reported(scene: Scene) -> None:
    detector, cut = scene.detector(), 0
    for x in np.linspace(0.45, 0.75, 13):
        found = detector.find(*scene.picture([(x, -0.6, 0.3)]))
        cut += not found
        for item in found:
            assert T_BASE_CAMERA.apply(item.point)[0] == pytest.approx(x, abs=0.5e-3)
    assert cut >= 3


@pytest.mark.parametrize(
    "size", [(0.02, 0.015, 0.03), (0.2, 0.04, 0.03), (0.06, 0.04, 0.004), (0.06, 0.04, 0.12)]
)
def test_what_is_no_item_by_its_size_is_not_reported(scene: Scene, size: tuple[float, float, float]) -> None:
    assert scene.detector().find(*scene.picture([(0.1, -0.6, 0.3)], size=size)) == ()


def test_an_item_of_the_belts_colour_is_not_reported_instead_of_badly_measured(scene: Scene) -> None:
    grey = (BELT_GREY + 2.0,) * 3
    assert scene.detector().find(*scene.picture([(0.1, -0.6, 0.3)], colour=grey)) == ()


def test_only_the_region_is_looked_at(scene: Scene) -> None:
    corners = np.array([[-0.3, -0.8, 0.0], [0.15, -0.8, 0.0], [0.15, -0.4, 0.0], [-0.3, -0.4, 0.0]])
    region = T_BASE_CAMERA.inv().apply(corners).tolist()
    found = scene.detector(region=region).find(*scene.picture([(0.0, -0.6, 0.3), (0.3, -0.6, 0.3)]))
    assert [round(float(T_BASE_CAMERA.apply(item.point)[0]), 2) for item in found] == [0.0]


@pytest.mark.parametrize(
    "changes", [{"normal": [0.0, 0.0, -2.0]}, {"min_height_m": 0.1}, {"size_m": [0.1]}, {"offset_m": "far"}]
)
def test_a_description_that_makes_no_sense_is_refused(scene: Scene, changes: dict[str, object]) -> None:
    with pytest.raises(CellError, match="items"):
        scene.spec(**changes)


def test_without_depth_an_item_of_known_height_is_found_by_its_colour(scene: Scene) -> None:
    detector = scene.detector(height_m=0.03, height_sigma_m=0.0003)
    dark_sides = [(-0.24, -0.68, 2.52), (-0.21, -0.61, 1.68)]
    errors, stated = [], []
    for x, y, yaw in [*PLACES, *dark_sides]:
        (item,) = detector.find(scene.picture([(x, y, yaw)], 0.15)[0], None)
        errors.append(T_BASE_CAMERA.apply(item.point) - [x, y, 0.03])
        stated.append(item.sigma_m)
        assert item.size_m == pytest.approx((0.06, 0.04), abs=0.0015)
    assert np.abs(errors).max() < 0.4e-3
    assert np.sqrt(np.mean(np.square(errors), axis=0))[:2].max() < 1.5 * np.mean(stated)


def test_by_colour_all_items_are_found_in_uneven_light_and_neither_floor_nor_what_has_another_size(
    scene: Scene,
) -> None:
    colour = scene.picture([*PLACES, (0.1, -0.62, 0.0)])[0].astype(float)
    down, across = np.mgrid[-1:1:800j, -1:1:1280j]
    colour *= (1.0 - 0.15 * (down**2 + across**2))[..., None]  # 30 % less light in the corners
    colour[:60] = 150.0  # beside the belt
    found = scene.detector(height_m=0.03).find(colour.astype(np.uint8), None)
    at = np.array([T_BASE_CAMERA.apply(item.point)[:2] for item in found])
    assert len(found) == 7
    for x, y, _ in [*PLACES, (0.1, -0.62, 0.0)]:
        assert np.linalg.norm(at - [x, y], axis=1).min() < 0.4e-3
    assert scene.detector(height_m=0.03, size_m=[0.08, 0.15]).find(colour.astype(np.uint8), None) == ()
    assert scene.detector(height_m=0.03).find(scene.picture([])[0], None) == ()


def test_a_height_that_is_wrong_is_in_the_stated_uncertainty(scene: Scene) -> None:
    x, y = -0.25, -0.5  # seen at a slant
    (item,) = scene.detector(height_m=0.033, height_sigma_m=0.003).find(scene.picture([(x, y, 0.3)])[0], None)
    off = T_BASE_CAMERA.apply(item.point)[:2] - [x, y]
    assert 0.3e-3 < np.linalg.norm(off) < 2.0 * item.sigma_m


def test_without_depth_and_without_a_known_height_it_is_said_what_to_give(scene: Scene) -> None:
    with pytest.raises(CellError, match="known height of all items") as caught:
        scene.detector().find(scene.picture([])[0], None)
    assert caught.value.name == "CAMERA_FAULT"


def test_a_larger_thing_in_the_margin_of_a_window_is_not_taken_for_the_item() -> None:
    away = np.zeros((70, 120))
    away[28:44, 50:66] = 100.0
    away[:12] = 100.0  # of something beside it
    whole = silhouette(away, 20)
    assert whole is not None
    assert (whole.sum(), whole[:20].any()) == (16 * 16, False)
    away[12:28, 55:60] = 100.0  # they lie against each other
    assert silhouette(away, 20) is None


def test_a_smear_longer_than_what_is_looked_at_of_an_edge_makes_a_place_less_sure(
    scene: Scene,
) -> None:
    subject = scene.detector(height_m=0.03)
    place = (0.05, -0.6, 0.3)
    says = {}
    for speed in (0.0, 0.1):
        colour, _ = scene.picture([place], speed_m_s=speed, exposure_s=0.1)
        (item,) = subject.find(colour, None)
        off = float(np.linalg.norm(T_BASE_CAMERA.apply(item.point)[:2] - place[:2]))
        assert off < 2.448 * item.sigma_m
        says[speed] = item.sigma_m
    assert says[0.0] < 0.00015
    assert says[0.1] > 2.0 * says[0.0]
