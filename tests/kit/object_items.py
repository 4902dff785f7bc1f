"""What the camera of the object face sees on the belt of the scenario ``picking``."""

from typing import Any

from cell.devices import ItemView
from cell.poses import Array
from fakes.object import VirtualClock
from fakes.object.head import CameraHead
from fakes.world.scenario import Scenario
from fakes.world.world import World


def items_of_seconds(count: int, **camera: Any) -> tuple[Array, list[ItemView]]:
    """The belt's normal in the camera (3,), and the items of ``count`` looks a second apart, by a ``camera``
    that is changed so in the ideal world."""
    truth = Scenario.load("picking:ideal").world
    changed = truth.camera.model_copy(update=camera)
    world = World(truth.model_copy(update={"camera": changed}), 0.0)
    T_camera_belt = world.scene(0.0).T_base_camera.inv() * world.belt.T_base_belt
    normal = T_camera_belt.rotation.apply([0.0, 0.0, 1.0])
    heights = {"min_height_m": 0.01, "max_height_m": 0.08, "size_m": [0.03, 0.15]}
    spec = {"normal": normal.tolist(), "offset_m": float(normal @ T_camera_belt.translation), **heights}
    head = CameraHead(world, VirtualClock())
    return normal, [item for k in range(count) for item in head.items(3.0 + k, k, spec) or ()]
