"""What the camera sees of the belt: the belt itself, and the boxes on it."""

from collections.abc import Sequence

from scipy.spatial.transform import RigidTransform

from fakes.frames.boxes import Box
from fakes.frames.render import Band
from fakes.world import World

_LOOK_M = 3.0  # along the belt, each way


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
    numbers = [number for number, _ in world.items.on_belt(middle, -_LOOK_M, _LOOK_M)]
    return [[_box(world, number, t) for number in numbers] for t in times]


def _box(world: World, number: int, t: float) -> Box:
    assert world.items is not None
    T: RigidTransform = world.scene(t).T_base_camera.inv() * world.items.pose(number, t)
    truth = world.items.truth
    length, width, height = truth.size_m
    blue, green, red = truth.colour
    return Box(T, (length, width, height), (blue, green, red))
