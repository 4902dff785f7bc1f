"""Poses of the flange that a camera wants, as commands to the arm."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_about import arm_with
from calibration.adjustment.mount import Mounted
from calibration.adjustment.target_correction import CONSTANT, MODEL
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.identification.application import reach
from cell.errors import error
from cell.formats.axbc import TARGETS_SCHEMA, AxbcTargets
from cell.formats.reading import parse, read_json
from cell.poses import Array, from_pose6
from procedures.hand_eye.solve.result import pose6

UNREACHABLE = "targets.unreachable"
_FEW = 8  # are named one by one


@dataclass(frozen=True)
class TargetCorrections:
    """What commands are made of: T_base_camera (4, 4) as given and by the plain mean, and the
    arm with its errors; None where there is none."""

    given: Array
    constant: Array
    model: tuple[Mounted, ArmKnown] | None


def answer_targets(
    path: Path, ways: TargetCorrections, chosen: str
) -> tuple[list[list[float] | None], list[tuple[str, str]]]:
    """``T_base_flange`` to command for each target of a ``cellward.axbc-targets/1``, null where out of
    reach, and what to warn of; by the way that was ``chosen``."""
    asked = parse(AxbcTargets, read_json(path), TARGETS_SCHEMA, str(path))
    wanted = np.array([se3.matrices(from_pose6(t)) for t in asked.targets]).reshape(-1, 4, 4)
    if chosen != MODEL or ways.model is None or not len(wanted):
        X = ways.constant if chosen == CONSTANT else ways.given
        return [pose6(T) for T in X @ wanted], []
    found, arm = ways.model
    near = None if asked.q_near is None else _hints(path, asked, arm.model.joints)
    q, reached = corrected_joints(found, arm, wanted, near)
    command = arm.model.base.flange(np.where(reached[:, None], q, 0.0))
    lost = np.flatnonzero(~reached)
    warnings = []
    if len(lost):
        named = ", ".join(str(int(k)) for k in lost[:_FEW]) + (" and more" if len(lost) > _FEW else "")
        text = f"targets {named} are out of the arm's reach, or too far from q_near; commands are null there"
        warnings.append((UNREACHABLE, text))
    return [pose6(T) if ok else None for T, ok in zip(command, reached, strict=True)], warnings


def corrected_joints(
    found: Mounted, arm: ArmKnown, wanted: Array, near: Array | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Joints (k, 6) at which the arm with its errors has its flange at ``wanted`` (k, 4, 4) T_camera_flange,
    and which of them were found."""
    corrected, values = arm_with(found.numbers, arm)
    answer = reach(corrected.chain(values), found.X @ wanted, near, arm.Q, level=False)
    return answer.q, answer.found


def _hints(path: Path, asked: AxbcTargets, joints: int) -> Array:
    hints = asked.q_near or []
    for k, q in enumerate(hints):
        if len(q) != joints:
            raise error("DATA_INVALID", f"{path}: q_near[{k}] has {len(q)} joints; the robot has {joints}")
    return np.array(hints, dtype=float)
