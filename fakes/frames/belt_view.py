"""What the camera sees of the belt: the belt itself, and the boxes on it."""

from collections.abc import Sequence

from scipy.spatial.transform import RigidTransform

from fakes.frames.boxes import Box
from fakes.frames.render import Band
from fakes.world.world import World

_LOOK = 1.3  # heights of the camera above the belt, along it each way


def belt_seen(world: World) -> Band | None:
    """The belt as a band through the picture of a camera that stands still; None without one."""
    if world.belt is None or world.eye_in_hand:
        return None
    return Band(world.scene(world.t0).T_base_camera.inv() * world.belt.T_base_belt)


def boxes_seen(world: World, times: Sequence[float]) -> list[list[Box]]:
    """For each of ``times`` the same boxes in the same order, farthest down the belt first."""
    if world.items is None:
        return []
    items, middle = world.items, times[len(times) // 2]
    T_camera_base = world.scene(middle).T_base_camera.inv()  # the camera stands still, and items only shift
    along, _, height = (T_camera_base * items.belt.T_base_belt).inv().translation
    numbers = items.numbers(middle, float(along - _LOOK * height), float(along + _LOOK * height))
    poses = {number: T_camera_base * items.pose(number, middle) for number in numbers}
    blue, green, red = items.truth.colour

    def box(number: int, t: float) -> Box:
        t += float(world.camera.row_delay_s(poses[number].translation))
        moved = items.grasp_point(number, t) - items.grasp_point(number, middle)
        T, shift = poses[number], T_camera_base.rotation.apply(moved)
        if shift.any():
            T = RigidTransform.from_components(T.translation + shift, T.rotation)
        return Box(T, items.lying(number).size_m, (blue, green, red))

    return [[box(number, t) for number in numbers] for t in times]
