"""What the motion port checks and computes before and after the child is asked."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.errors import CellError, error
from cell.poses import Array, from_pose6


def open_failure(exc: CellError) -> CellError:
    """The coded error behind what the native client said when its interface did not open."""
    text = exc.detail
    if "already in use" in text:
        return error("ARM_REGISTER_CONFLICT", text)
    if "remote control" in text:
        return error("ARM_LOCAL_MODE", text)
    return exc


def same_pose(a: Array, b: Array) -> bool:
    """Equal within a micrometre and a microradian, whichever of its two rotation vectors each uses."""
    difference = from_pose6(a).inv() * from_pose6(b)
    return bool(np.linalg.norm(difference.translation) < 1e-6 and difference.rotation.magnitude() < 1e-6)


def finite(values: Array, shape: tuple[int, ...], what: str) -> Array:
    array = np.asarray(values, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise error("ARGUMENT_INVALID", f"{what} needs {shape[0]} finite numbers, got {array}")
    return array


def shortened(start: RigidTransform, end: RigidTransform, max_travel_m: float) -> RigidTransform:
    """The point of the straight move from ``start`` to ``end`` after at most ``max_travel_m``."""
    step = end.translation - start.translation
    travel = float(np.linalg.norm(step))
    if travel <= max_travel_m:
        return end
    part = max_travel_m / travel
    turn = (start.rotation.inv() * end.rotation).as_rotvec()
    return RigidTransform.from_components(
        start.translation + part * step, start.rotation * Rotation.from_rotvec(part * turn)
    )
