"""The other ways in which a pose is often written down: what a set's flange poses are when read that way."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cell.poses import Array

TIME = "poses.time"
INVERTED = "poses.inverted"
SWAPPED = "poses.frames-swapped"
QUATERNION = "poses.quaternion-order"
UNITS_R, UNITS_T = "units.rotation", "units.translation"
LEVER_M = 0.3  # at which a turn counts as much as a shift, where two poses are compared


@dataclass(frozen=True)
class Mistake:
    """A fixed ``code``, and what is wrong and how to correct it."""

    code: str
    text: str


def other_readings(poses: Array) -> Iterator[tuple[Mistake, Array]]:
    """T_base_flange (n, 4, 4) as ``poses`` (n, 6) may be meant, and what is wrong then."""
    raw = poses[:, 3:]
    vectors = Rotation.from_rotvec(raw)
    text = "the rotations of T_base_flange are {}; give rotation vectors in radians"
    yield Mistake(UNITS_R, text.format("in degrees")), _poses(poses, Rotation.from_rotvec(np.radians(raw)))
    millimetres = Mistake(
        UNITS_T, "the translations of T_base_flange are in millimetres; divide them by 1000"
    )
    yield millimetres, _poses(poses * ([1e-3] * 3 + [1.0] * 3), vectors)
    both = Mistake(
        UNITS_R,
        "the translations of T_base_flange are in millimetres, and its rotations in degrees; give m, rad",
    )
    yield both, _poses(poses * ([1e-3] * 3 + [1.0] * 3), Rotation.from_rotvec(np.radians(raw)))
    transposed = (
        "the rotations of T_base_flange are inverted, as matrices read by columns are; transpose them"
    )
    yield Mistake(INVERTED, transposed), _poses(poses, vectors.inv())
    x, y, z, w = vectors.as_quat().T
    for was, taken, numbers in (
        ("x, y, z, w", "w, x, y, z", (w, x, y, z)),
        ("w, x, y, z", "x, y, z, w", (y, z, w, x)),
    ):
        order = f"the rotations of T_base_flange come from quaternions {was} that were read as {taken}"
        yield Mistake(QUATERNION, order), _poses(poses, Rotation.from_quat(np.stack(numbers, axis=1)))
    for unit, angles in (("radians", raw), ("degrees", np.radians(raw))):
        for axes, name in (
            ("xyz", "roll, pitch, yaw"),
            ("ZYX", "yaw, pitch, roll"),
            ("XYZ", "about x, y', z''"),
        ):
            what = f"Euler angles ({name}) in {unit}"
            yield Mistake(UNITS_R, text.format(what)), _poses(poses, Rotation.from_euler(axes, angles))


def _poses(poses: Array, rotations: Rotation) -> Array:
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = rotations.as_matrix(), poses[:, :3]
    return out
