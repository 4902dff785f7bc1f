"""Plans of camera poses: cones around a board, small search moves, and what accuracy to expect of them."""

from calibration.planning.cone import (
    ConeShape,
    board_centre,
    candidate_axes,
    cone_poses,
    rotation_spread,
)
from calibration.planning.layout import plan_telling_cone
from calibration.planning.mounting import EyeInHand, EyeToHand, Mounting
from calibration.planning.plan import ConePlan, PlannedPose, RejectedPose
from calibration.planning.planner import ConeRequest, plan_cone, plan_views
from calibration.planning.prediction import PredictedUncertainty
from calibration.planning.search import search_moves
from calibration.planning.view import view_faults
from calibration.planning.volume import Volume, beyond_volume, candidate_views, spread_views

__all__ = [
    "ConePlan",
    "ConeRequest",
    "ConeShape",
    "EyeInHand",
    "EyeToHand",
    "Mounting",
    "PlannedPose",
    "PredictedUncertainty",
    "RejectedPose",
    "Volume",
    "beyond_volume",
    "board_centre",
    "candidate_axes",
    "candidate_views",
    "cone_poses",
    "plan_cone",
    "plan_telling_cone",
    "plan_views",
    "rotation_spread",
    "search_moves",
    "spread_views",
    "view_faults",
]
