"""The poses of a check, for the worker process: plain values in, a plan out."""

from dataclasses import dataclass, replace

import numpy as np

from calibration.planning import (
    ConeRequest,
    ConeShape,
    Volume,
    candidate_views,
    plan_views,
    spread_views,
    view_faults,
)
from calibration.targets import make_target
from cell.poses import from_pose6
from procedures.arm_setup import lease_settings
from procedures.hand_eye.plan import PlacementPlan, PlanRequest, Visit, camera_to_target, mounting_of


@dataclass(frozen=True)
class VolumeRequest:
    """``common`` is as of a placement, whose cone is not used."""

    common: PlanRequest
    volume: Volume


def plan_volume(request: VolumeRequest) -> PlacementPlan:
    """Poses over what the camera sees and the arm reaches; ``PLAN_INFEASIBLE`` with the reasons."""
    common, volume = request.common, request.volume
    view = common.view
    guard, _, _ = lease_settings(common.values)
    points = make_target(common.target).points
    seen = camera_to_target(view, points)
    cone = ConeRequest(
        mounting=mounting_of(common.setup, common.calibration, from_pose6(view.T_base_flange), seen),
        shape=ConeShape(volume.poses, volume.tilt_rad, volume.nearest_m),
        target_points=points,
        intrinsics=view.intrinsics(),
        T_camera_target=seen,
        q_start=np.array(view.q),
        skip=frozenset(common.finished),
    )
    views = candidate_views(volume, seen, points, cone.intrinsics)
    faults = view_faults(views, points, cone.intrinsics, cone.margin_px)
    chosen = spread_views(
        volume,
        views,
        faults,
        cone.mounting.flange(views),
        cone.q_start,
        guard.model,
        guard.check_path_joints,
    )
    shape = ConeShape(len(chosen), volume.tilt_rad, volume.nearest_m)
    plan = plan_views(
        replace(cone, shape=shape),
        chosen,
        guard.model,
        guard.check_path_joints,
    ).described(lambda q: guard.describe(q).as_dict())
    needed = max(common.min_poses - len(common.finished), 0)
    if (problem := plan.shortfall(needed)) is not None and not common.finished:
        raise problem
    return PlacementPlan([Visit(p.index, [float(v) for v in p.q]) for p in plan.poses], plan.as_dict())
