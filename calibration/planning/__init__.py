"""Plans of camera poses: cones around a board, small search moves, and what accuracy to expect of them."""

from calibration.planning.cone import (
    ConeAxis,
    ConeShape,
    board_centre,
    candidate_axes,
    cone_poses,
    rotation_spread,
)
from calibration.planning.layout import plan_telling_cone
from calibration.planning.mounting import EyeInHand, EyeToHand, Mounting
from calibration.planning.plan import ConePlan, PlannedPose, RejectedPose
from calibration.planning.planner import Checker, ConeRequest, plan_cone
from calibration.planning.prediction import PredictedUncertainty
from calibration.planning.search import SearchMove, search_moves
from calibration.planning.view import view_faults

__all__ = [
    "Checker",
    "ConeAxis",
    "ConePlan",
    "ConeRequest",
    "ConeShape",
    "EyeInHand",
    "EyeToHand",
    "Mounting",
    "PlannedPose",
    "PredictedUncertainty",
    "RejectedPose",
    "SearchMove",
    "board_centre",
    "candidate_axes",
    "cone_poses",
    "plan_cone",
    "plan_telling_cone",
    "rotation_spread",
    "search_moves",
    "view_faults",
]
