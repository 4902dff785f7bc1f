"""Poses as others write them: quaternions, matrices, rotation vectors, Euler angles in a named order."""

from collections.abc import Sequence
from math import pi

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import from_pose6

# Named orders as SciPy writes them: capitals turn about the axes that turned along, small letters about axes
# that stand still; the first letter belongs to the first number.
EULER = {
    "rpy": "xyz",  # ROS and URDF: roll, pitch, yaw about fixed axes
    "fanuc-wpr": "xyz",  # W, P, R
    "kuka-abc": "ZYX",  # A about z first
    "staubli": "XYZ",  # Rx, Ry, Rz of VAL 3
    "kawasaki-oat": "ZYZ",
}
LENGTHS = {"m": 1.0, "mm": 1e-3}
ANGLES = {"rad": 1.0, "deg": pi / 180.0}
_QUATERNION_OFF = 1e-3  # four decimals round a unit quaternion by less
_MATRIX_OFF = 5e-3  # three decimals round a rotation by less


class PoseFault(ValueError):
    """Numbers that are no pose; the text says why and what to do, without the place."""


def euler_order(text: str) -> str:
    """SciPy's letters of a named order, or of such letters; :class:`PoseFault` else."""
    order = EULER.get(text.casefold(), text)
    letters = order.casefold()
    good = len(order) == 3 and set(letters) <= set("xyz") and order in (order.upper(), order.lower())
    if not good or letters[0] == letters[1] or letters[1] == letters[2]:
        raise PoseFault(
            f"'{text}' is no order of Euler angles: give {', '.join(EULER)}, or three letters as in ZYX "
            "(axes that turn along) or xyz (axes that stand still)"
        )
    return order


def quaternion(translation: Sequence[float], xyzw: Sequence[float]) -> RigidTransform:
    """A pose of translation (m) and unit quaternion x, y, z, w."""
    norm = float(np.linalg.norm(xyzw))
    if abs(norm - 1.0) > _QUATERNION_OFF:
        raise PoseFault(f"the quaternion has the length {norm:.4g}, not 1: check the order of its columns")
    return RigidTransform.from_components(translation, Rotation.from_quat(xyzw))


def euler(translation: Sequence[float], angles: Sequence[float], order: str) -> RigidTransform:
    """A pose of translation (m) and three angles (rad) in ``order``, a result of :func:`euler_order`."""
    return RigidTransform.from_components(translation, Rotation.from_euler(order, angles))


def rotation_vector(translation: Sequence[float], vector: Sequence[float]) -> RigidTransform:
    """A pose of translation (m) and axis times angle (rad)."""
    return from_pose6([*translation, *vector])


def matrix(numbers: Sequence[float], length: float = 1.0) -> RigidTransform:
    """A pose of 12 or 16 numbers, row after row; ``length`` is one unit of the last column in metres."""
    m = np.asarray(numbers, dtype=float)
    if m.size not in (12, 16):
        raise PoseFault(f"a matrix has 16 numbers, or 12 without its last row, not {m.size}")
    whole = np.eye(4)
    whole[: m.size // 4] = m.reshape(-1, 4)
    if not np.allclose(whole[3], [0.0, 0.0, 0.0, 1.0], atol=1e-9):
        raise PoseFault(
            "the matrix does not end with 0, 0, 0, 1: it is written column after column; transpose it"
        )
    turn = whole[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > _MATRIX_OFF:
        raise PoseFault("the matrix is no rotation: its rows are not of length 1 at right angles")
    if np.linalg.det(turn) < 0:
        raise PoseFault("the matrix mirrors (its determinant is -1): an axis has the wrong sign")
    whole[:3, 3] *= length
    return RigidTransform.from_matrix(whole)
