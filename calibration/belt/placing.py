"""How far items on a belt are off, all alike, by what is wrong with the camera's pose and its lens.

An item lies where the sight through its pixels meets a level of the base. A pose that is off moves and turns
the sight, a lens that is off turns it. Both were found from the same pictures: what one of them errs by, the
other mostly makes up for, so their errors have to be taken together.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.adjustment.lens_terms import LENS, LensPrior, projected
from calibration.hand_eye import se3
from cell.devices import Intrinsics
from cell.poses import Array

POSE = 6
NUMBERS = POSE + len(LENS)


def off_by_camera(points: Array, T_base_camera: RigidTransform, lens: Intrinsics) -> Array:
    """(n, 2, 14): how far items at ``points`` (n, 3) m in the base move along its x and y, at their height,
    by a unit of the camera's pose (6, in its own axes) and of the numbers ``LENS`` of its lens."""
    R, seen = T_base_camera.rotation.as_matrix(), T_base_camera.inv().apply(points)
    _, by_point, by_lens = projected(np.ascontiguousarray(seen), lens)
    moved = np.zeros((len(points), 3, NUMBERS))
    moved[:, :, :3], moved[:, :, 3:POSE] = np.eye(3), -se3.hat(seen)
    moved[:, :2, POSE:] = -np.linalg.solve(by_point[:, :, :2], by_lens)  # the pixels stay
    moved, sight = R @ moved, seen @ R.T
    out: Array = moved[:, :2] - (sight[:, :2] / sight[:, 2:])[:, :, None] * moved[:, 2:]
    return out


def left_open(points: Array, T_base_camera: RigidTransform, lens: Intrinsics, cov: Array) -> Array:
    """(2, 2) m^2 of x, y of an item that was seen at ``points`` (n, 3) m: what pose and lens of the camera,
    with ``cov`` (14, 14), leave open, for all items alike."""
    by = off_by_camera(points, T_base_camera, lens).mean(axis=0)
    out: Array = by @ cov @ by.T
    return out


def camera_cov(cov: Array, with_lens: Array | None, told: LensPrior | None) -> Array:
    """(14, 14) of pose and lens, from the pose's ``cov`` (6, 6), and that of both, ``with_lens``, if known.

    ``told``: how well a lens is known that was not found with the pose. One that was adjusted with it needs
    nothing beside ``cov``, which has it as an unknown: without what goes together that is more, not less.
    """
    if told is None and with_lens is not None:
        return with_lens
    out = np.zeros((NUMBERS, NUMBERS))
    out[:POSE, :POSE] = cov
    if told is not None:
        out[POSE:, POSE:] = np.diag(told.sigma() ** 2)
    return out
