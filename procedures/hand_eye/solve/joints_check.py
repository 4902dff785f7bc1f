"""Whether ``T_base_flange`` is where robot has its flange at ``q``; the refusal names the likely mistake."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.kinematics.parametric import ParametricArm
from cell.errors import error
from cell.poses import Array
from procedures.hand_eye.solve.capture import CaptureSet
from procedures.hand_eye.solve.joint_zero import CODE as ZERO
from procedures.hand_eye.solve.joint_zero import best_offset
from procedures.hand_eye.solve.other_writing import (
    INVERTED,
    LEVER_M,
    SWAPPED,
    TIME,
    UNITS_R,
    Mistake,
    other_readings,
)

TCP = "poses.tcp"
_NEAR_M, _NEAR_RAD = 0.01, 0.02  # an arm differs from its model by millimetres
_TCP_M = 3e-3  # an offset that is the same everywhere is a tool's, where an arm's error changes
_SMALL_M, _SMALL_RAD = 2e-3, 2e-3
_LEFT = 0.1
_SAME = 0.2  # of an offset: what it may change by to be the same everywhere


def check_joints(loaded: CaptureSet, rows: NDArray[np.int64], arm: ParametricArm, Q: Array) -> None:
    """Refuse flange poses that are not those of ``arm`` at joints ``Q`` (n, j) of observations ``rows``."""
    F = loaded.F[rows]
    flange = arm.base.flange(Q)
    far, turned = _apart(flange, F)
    if far < _NEAR_M and turned < _NEAR_RAD:
        mistake = _small_mistake(arm, Q, F)
        if mistake is None:
            return
    else:
        poses = np.array([loaded.capture.observations[int(row)].T_base_flange for row in rows])
        mistake = next(_mistakes(arm, Q, F, poses), None)
    code, cause = "", "look at the order of the joints, their unit (rad), and the model of robot"
    if mistake is not None:
        code, cause = f"{mistake.code}: ", mistake.text
    raise error(
        "DATA_INVALID",
        f"{loaded.path}: {code}T_base_flange is not where robot has its flange at q: {1e3 * far:.1f} mm and "
        f"{np.degrees(turned):.1f} deg off (median); {cause}",
    )


def _apart(flange: Array, F: Array) -> tuple[float, float]:
    """Median distance in metres and radians."""
    off = se3.inverse(flange) @ F
    turned = np.linalg.norm(se3.rotation_vectors(off[:, :3, :3]), axis=1)
    return float(np.median(np.linalg.norm(off[:, :3, 3], axis=1))), float(np.median(turned))


def _near(flange: Array, F: Array) -> bool:
    far, turned = _apart(flange, F)
    return far < _NEAR_M and turned < _NEAR_RAD


def _small_mistake(arm: ParametricArm, Q: Array, F: Array) -> Mistake | None:
    """A short tool or a zero that is a little off, where it leaves nothing as an arm's own errors do not."""
    flange = arm.base.flange(Q)
    if (tool := _tool(flange, F)) is not None:
        return _carries(tool)
    far, turned = _apart(flange, F)
    return _zero(arm, Q, F, _LEFT) if far > _SMALL_M or turned > _SMALL_RAD else None


def _carries(tool: Array) -> Mistake:
    x, y, z = 1e3 * tool[:3, 3]
    turn = float(np.degrees(_turn(tool)))
    also = f", turned by {turn:.1f} deg" if turn > np.degrees(_NEAR_RAD) else ""
    text = f"they carry a tool: a TCP of [{x:.1f}, {y:.1f}, {z:.1f}] mm{also}; give the flange's poses"
    return Mistake(TCP, text)


def _mistakes(arm: ParametricArm, Q: Array, F: Array, poses: Array) -> Iterator[Mistake]:
    """What makes poses and joints agree, the simplest first."""
    flange = arm.base.flange(Q)
    if (tool := _tool(flange, F)) is not None:
        yield _carries(tool)
    if _near(flange, se3.inverse(F)):
        yield Mistake(INVERTED, "they are inverted (T_flange_base); invert them")
    if _near(arm.base.flange(np.radians(Q)), F):
        yield Mistake(UNITS_R, "q is in degrees; give radians")
    for mistake, other in other_readings(poses):
        if _near(flange, other):
            yield mistake
    if (zero := _zero(arm, Q, F)) is not None:
        yield zero
    frame = se3.mean_pose(F @ se3.inverse(flange))
    if _near(frame @ flange, F):
        text = "they are given in another frame than the robot's base, {:.1f} mm and {:.1f} deg away from it"
        yield Mistake(
            SWAPPED, text.format(1e3 * float(np.linalg.norm(frame[:3, 3])), np.degrees(_turn(frame)))
        )
    order = _order(flange, F)
    if _near(flange[order], F):
        moved = int(np.sum(order != np.arange(len(order))))
        text = f"{moved} of {len(order)} belong to the joints of another observation; put them in order"
        yield Mistake(TIME, text)


def _zero(arm: ParametricArm, Q: Array, F: Array, left: float = 1.0) -> Mistake | None:
    """The one joint whose offset leaves no more than the share ``left`` of the disagreement."""

    def disagreement(offsets: Array) -> float:
        far, turned = _apart(arm.base.flange(Q + offsets), F)
        return far + LEVER_M * turned

    found = best_offset(disagreement, Q.shape[1], range(Q.shape[1]))
    if found is None:
        return None
    j, offset = found
    offsets = offset * np.eye(Q.shape[1])[j]
    if not _near(arm.base.flange(Q + offsets), F):
        return None
    if disagreement(offsets) > left * disagreement(np.zeros(Q.shape[1])):
        return None
    return Mistake(
        ZERO,
        f"they agree when joint {j + 1} stands {np.degrees(offset):+.2f} deg from where q has it; correct q, "
        "or the joint's zero",
    )


def _tool(flange: Array, F: Array) -> Array | None:
    """(4, 4) of a tool that the poses carry, the same at all of them; None where they carry none."""
    off = se3.inverse(flange) @ F
    mean = se3.mean_pose(off)
    shift = float(np.median(np.linalg.norm((off - mean)[:, :3, 3], axis=1)))
    twist = se3.rotation_vectors(mean[:3, :3].T @ off[:, :3, :3])
    turn = float(np.median(np.linalg.norm(twist, axis=1)))
    size = float(np.linalg.norm(mean[:3, 3]))
    if shift > _NEAR_M or turn > _NEAR_RAD:
        return None
    shifted = size > _TCP_M and shift < _SAME * size
    turned = _turn(mean) > _NEAR_RAD and turn < _SAME * _turn(mean)
    return mean if shifted or turned else None


def _turn(T: Array) -> float:
    """Angle in radians of (4, 4)."""
    return float(np.linalg.norm(se3.rotation_vectors(T[None, :3, :3])))


def _order(flange: Array, F: Array) -> NDArray[np.int64]:
    """(n,) the joints that each pose is nearest to, each used once."""
    from scipy.optimize import linear_sum_assignment  # 12 MB that a good set has no use for

    away = np.linalg.norm(flange[None, :, :3, 3] - F[:, None, :3, 3], axis=2)
    trace = np.einsum("kij,lij->lk", flange[:, :3, :3], F[:, :3, :3])
    cost = away + LEVER_M * np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    return np.asarray(linear_sum_assignment(cost)[1], dtype=np.int64)
