"""What the camera sees of the belt: the belt itself, and the boxes on it."""

from collections.abc import Sequence

from scipy.spatial.transform import RigidTransform

from fakes.frames.boxes import Box
from fakes.frames.render import Band
from fakes.items import Items
from fakes.world import World

_LOOK_M = 1.5  # along the belt from below the camera, each way


def belt_seen(world: World) -> Band | None:
    """The belt as a band through the picture of a camera that stands still; None without one."""
    if world.belt is None or world.eye_in_hand:
        return None
    return Band(world.scene(world.t0).T_base_camera.inv() * world.belt.T_base_belt)


def boxes_seen(world: World, times: Sequence[float]) -> list[list[Box]]:
    """For each of ``times`` the same boxes in the same order, farthest down the belt last."""
    if world.items is None:
        return []
    middle = times[len(times) // 2]
    T_camera_base = world.scene(middle).T_base_camera.inv()  # the camera stands still
    here = float((world.items.belt.T_base_belt.inv() * T_camera_base.inv()).translation[0])
    numbers = world.items.numbers(middle, here - _LOOK_M, here + _LOOK_M)
    return [[_box(world.items, number, T_camera_base, t) for number in numbers] for t in times]


def _box(items: Items, number: int, T_camera_base: RigidTransform, t: float) -> Box:
    length, width, height = items.truth.size_m
    blue, green, red = items.truth.colour
    return Box(T_camera_base * items.pose(number, t), (length, width, height), (blue, green, red))
