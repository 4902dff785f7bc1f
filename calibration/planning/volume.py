"""Views of a target over the volume that a fixed camera sees: places, distances and tilts spread evenly."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.planning.cone import board_centre
from calibration.planning.planner import Checker
from cell.arm_model import ArmModel
from cell.devices import Intrinsics
from cell.errors import CellError
from cell.even_points import even_points
from cell.poses import Array

_ROLL_RAD = 1.0  # either way of the roll that the target has now
_MIDDLE = 0.8  # of the image, where the target's centre may be
_LEVER_M = 0.3  # at which a turn counts as much as a shift
_CANDIDATES = 8  # for each pose that is wanted
_SEED = 14


@dataclass(frozen=True)
class Volume:
    """How many ``poses``, between which distances (m) from the camera, and tilted by how much (rad)."""

    poses: int
    nearest_m: float
    farthest_m: float
    tilt_rad: float


def candidate_views(
    volume: Volume, seen: RigidTransform, points: Array, camera: Intrinsics
) -> RigidTransform:
    """T_camera_target (n) of views to choose from; ``seen`` is the target as it is now."""
    count = _CANDIDATES * volume.poses
    even = even_points(6, int(np.ceil(np.log2(count))), _SEED)[:count]
    distance = volume.nearest_m + (volume.farthest_m - volume.nearest_m) * even[:, 0]
    fx, fy, cx, cy = camera.K
    u = cx + _MIDDLE * (even[:, 1] - 0.5) * camera.width
    v = cy + _MIDDLE * (even[:, 2] - 0.5) * camera.height
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(count)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    turn, tilt = 2.0 * np.pi * even[:, 3], volume.tilt_rad * np.sqrt(even[:, 4])
    tilts = np.stack([tilt * np.cos(turn), tilt * np.sin(turn), np.zeros(count)], axis=1)
    rolls = np.outer(_ROLL_RAD * (2.0 * even[:, 5] - 1.0), [0.0, 0.0, 1.0])
    facing = Rotation.from_matrix(np.array([_facing(ray, seen.rotation) for ray in rays]))
    R = facing * Rotation.from_rotvec(rolls) * Rotation.from_rotvec(tilts)
    centre = board_centre(points)
    return RigidTransform.from_components(distance[:, None] * rays - R.apply(centre), R)


def beyond_volume(volume: Volume, view: RigidTransform, seen: RigidTransform, points: Array) -> str | None:
    """Why ``view``, a T_camera_target, lies beyond those of :func:`candidate_views` with this ``seen``, by
    its distance, tilt and roll; None where it does not."""
    centre = view.apply(board_centre(points))
    distance = float(np.linalg.norm(centre))
    facing = Rotation.from_matrix(_facing(centre / distance, seen.rotation))
    _, _, z, w = (facing.inv() * view.rotation).as_quat()  # a roll, then a tilt
    tilt = float(2.0 * np.arccos(min(np.hypot(z, w), 1.0)))
    roll = float(abs((2.0 * np.arctan2(z, w) + np.pi) % (2.0 * np.pi) - np.pi))
    for is_beyond, text in (
        (
            not volume.nearest_m <= distance <= volume.farthest_m,
            f"{distance:.2f} m before the camera, poses are from {volume.nearest_m:g} to "
            f"{volume.farthest_m:g} m",
        ),
        (
            tilt > volume.tilt_rad,
            f"tilted by {np.degrees(tilt):.0f} degrees, poses are by up to {np.degrees(volume.tilt_rad):.0f}",
        ),
        (
            roll > _ROLL_RAD,
            f"rolled by {np.degrees(roll):.0f} degrees from where the arm begins, poses are by up to "
            f"{np.degrees(_ROLL_RAD):.0f}",
        ),
    ):
        if is_beyond:
            return text
    return None


def spread_views(
    volume: Volume,
    views: RigidTransform,
    faults: Sequence[str | None],
    flanges: RigidTransform,
    q_start: Array,
    model: ArmModel,
    checker: Checker,
) -> RigidTransform:
    """The ``volume.poses`` views that lie farthest apart, of those that can be seen and reached.

    In an order that goes from each to the nearest one left, by joints.
    """
    reached: list[tuple[int, Array]] = []
    for k, fault in enumerate(faults):
        q = None if fault is not None else model.inverse(flanges[k], q_start)
        if q is not None and _free(checker, q):
            reached.append((k, q))
    if not reached:
        return views[:0]
    rows, Q = np.array([k for k, _ in reached], dtype=np.int64), np.array([q for _, q in reached])
    own = views[rows]
    at = np.concatenate(
        [own.translation, _LEVER_M * (own.rotation * views[0].rotation.inv()).as_rotvec()], axis=1
    )
    chosen = _farthest(at, volume.poses)
    return own[_nearest_next(Q[chosen], q_start, chosen)]


def _free(checker: Checker, q: Array) -> bool:
    try:
        checker(q, q)
    except CellError:
        return False
    return True


def _facing(ray: Array, now: Rotation) -> Array:
    """(3, 3) of a target that faces the camera along ``ray``, as near to ``now`` as may be."""
    R = now.as_matrix()
    z = ray * np.sign(R[:, 2] @ ray or 1.0)
    x = R[:, 0] - (R[:, 0] @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _farthest(at: Array, count: int) -> NDArray[np.int64]:
    """Rows of ``at`` (n, 6), each the farthest from those before; the first is the nearest to their mean."""
    chosen = [int(np.argmin(np.linalg.norm(at - at.mean(axis=0), axis=1)))]
    away = np.linalg.norm(at - at[chosen[0]], axis=1)
    while len(chosen) < min(count, len(at)):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(at - at[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)


def _nearest_next(Q: Array, start: Array, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    left, here, order = list(range(len(Q))), start, list[int]()
    while left:
        k = left[int(np.abs(Q[left] - here).max(axis=1).argmin())]
        left.remove(k)
        order.append(int(rows[k]))
        here = Q[k]
    return np.array(order, dtype=np.int64)
