"""Where to move a board that the arm cannot look at from most sides: found by planning for it there."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.planning import ConeRequest, EyeInHand, plan_cone
from calibration.planning.cone import candidate_axes
from calibration.planning.plan import RejectedPose
from calibration.planning.planner import Checker
from cell.arm_model import ArmModel
from cell.poses import Array

STEPS_M = (0.1, 0.2)
_NATURAL = 2  # of the candidate axes: enough to compare places
_REACH, _VIEW = "would leave the arm's reach", "would lose the board from view"


def lost_text(lost: Sequence[RejectedPose], wanted: int) -> str:
    """How many of the ``wanted`` poses are lost, and why: ``12 of 20 poses would leave the arm's reach``."""
    kinds = Counter(map(_kind, lost)).most_common()
    texts = [f"{count} of {wanted} poses {why}" for why, count in kinds[:1]]
    return ", ".join([*texts, *(f"{count} {why}" for why, count in kinds[1:3])])


def _kind(pose: RejectedPose) -> str:
    if "arm's reach" in pose.reason:
        return _REACH
    if "the board would" in pose.reason:
        return _VIEW
    return "would come too close to something or to a limit"


def where_to_move(request: ConeRequest, model: ArmModel, checker: Checker, enough: int) -> str:
    """``move the board 0.1 m towards the base (18 poses are reached there)``, or what else may help.

    A place is named where ``enough`` poses are reached, the one with most of those that are equally near.
    """
    mounting = request.mounting
    if not isinstance(mounting, EyeInHand):
        return "mount the board otherwise on the flange, or change distance_m"
    best, words, stands = enough - 1, "", mounting.T_base_target
    for step in STEPS_M:
        for direction, name in _directions(stands.translation):
            moved = RigidTransform.from_translation(step * direction) * stands
            seen = request.T_camera_target * (stands.inv() * moved)
            there = replace(
                request,
                T_camera_target=seen,
                mounting=EyeInHand(mounting.T_flange_camera, moved),
                axes=candidate_axes(seen, request.target_points)[:_NATURAL],
            )
            count = len(plan_cone(there, model, checker).poses)
            if count > best:
                best, words = count, f"move the board {step:g} m {name} ({count} poses are reached there)"
        if words:
            return words
    return f"no place within {STEPS_M[-1]:g} m helps: move the board elsewhere, or change distance_m"


def _directions(place: Array) -> list[tuple[Array, str]]:
    """Unit vectors in the base, and in words."""
    outward = np.array([place[0], place[1], 0.0])
    outward /= max(float(np.linalg.norm(outward)), 1e-9)
    up = np.array([0.0, 0.0, 1.0])
    return [
        (-outward, "towards the base"),
        (outward, "away from the base"),
        (up, "up"),
        (-up, "down"),
    ]
