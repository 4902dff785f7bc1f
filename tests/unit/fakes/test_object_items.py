"""What the camera of the object face makes of items, beside the detector that looks at pictures."""

import numpy as np
import pytest

from cell.devices import ItemView
from cell.poses import Array
from fakes.frames.stereo import stereo_depth
from fakes.object import VirtualClock
from fakes.object.head import CameraHead
from fakes.world.camera.truth import StereoTruth
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.item_scene import Scene

SCALE = 1.05


def seen_by_the_object_camera(scale: float) -> tuple[Array, list[ItemView]]:
    """The belt's normal in the camera (3,), and what was seen of the items of some seconds."""
    truth = Scenario.load("picking:ideal").world
    camera = truth.camera.model_copy(update={"stereo": StereoTruth(scale=scale)})
    world = World(truth.model_copy(update={"camera": camera}), 0.0)
    T_camera_belt = world.scene(0.0).T_base_camera.inv() * world.belt.T_base_belt
    normal = T_camera_belt.rotation.apply([0.0, 0.0, 1.0])
    heights = {"min_height_m": 0.01, "max_height_m": 0.08, "size_m": [0.03, 0.15]}
    spec = {"normal": normal.tolist(), "offset_m": float(normal @ T_camera_belt.translation), **heights}
    head = CameraHead(world, VirtualClock())
    return normal, [item for k in range(10) for item in head.items(3.0 + k, k, spec) or ()]


def test_depth_of_a_wrong_scale_shifts_items_along_their_sights_as_in_a_picture() -> None:
    normal, exact = seen_by_the_object_camera(1.0)
    _, scaled = seen_by_the_object_camera(SCALE)
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
    normal, items = seen_by_the_object_camera(1.0)
    slant = np.array([np.linalg.norm(i.point - (i.point @ normal) * normal) for i in items])
    says = np.array([i.sigma_m for i in items])
    assert (np.diff(says[np.argsort(slant)]) > -1e-9).all()
    assert says.max() > 1.05 * says.min()
