"""A finished plan: the poses to visit, in order, and why others are left out."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.planning.cone import ConeAxis, rotation_spread
from cell.errors import CellError, error
from cell.poses import Array, to_pose6

MIN_SPREAD_RAD = 0.05  # rotation about a second axis, below which X cannot be found

Describer = Callable[[Array], Mapping[str, Any]]
"""``describe(q)`` gives the margins of a pose for the listing."""


@dataclass(frozen=True, eq=False)
class PlannedPose:
    """One pose to visit. ``index`` is its place on the cone, not in the order of visits."""

    index: int
    q: Array  # (6,) rad
    T_base_flange: RigidTransform
    T_camera_target: RigidTransform  # as expected
    travel_rad: float  # largest joint move from the pose before
    checks: Mapping[str, Any] = field(default_factory=dict)  # margins of the pose

    def as_dict(self) -> dict[str, Any]:
        return {
            "index": self.index,
            "q": [float(v) for v in self.q],
            "T_base_flange": [float(v) for v in to_pose6(self.T_base_flange)],
            "T_camera_target": [float(v) for v in to_pose6(self.T_camera_target)],
            "travel_rad": self.travel_rad,
            "checks": dict(self.checks),
        }


@dataclass(frozen=True)
class RejectedPose:
    """A pose that cannot be visited, and why in words."""

    index: int
    reason: str


@dataclass(frozen=True, eq=False)
class ConePlan:
    """Poses in the order of visits; the way from the start, from pose to pose and back to it is free."""

    poses: Sequence[PlannedPose]
    rejected: Sequence[RejectedPose]
    axis: ConeAxis
    candidates_tried: int

    @property
    def spread_rad(self) -> float:
        """RMS rotation about the second strongest axis; near zero the set determines nothing."""
        if len(self.poses) < 3:
            return 0.0
        return rotation_spread(RigidTransform.concatenate([p.T_base_flange for p in self.poses]).rotation)

    @property
    def travel_rad(self) -> float:
        """Sum over the poses of the largest joint move."""
        return float(np.sum([p.travel_rad for p in self.poses]))

    def shortfall(self, min_poses: int) -> CellError | None:
        """``PLAN_INFEASIBLE`` with its reasons when the plan is not enough, else None."""
        reasons = Counter(r.reason for r in self.rejected).most_common(4)
        why = "; ".join(f"{count} x {reason}" for reason, count in reasons)
        if len(self.poses) < min_poses:
            return error("PLAN_INFEASIBLE", f"{len(self.poses)} poses of {min_poses} needed: {why}")
        if self.spread_rad < MIN_SPREAD_RAD:
            return error(
                "PLAN_INFEASIBLE",
                f"the {len(self.poses)} reachable poses turn only {self.spread_rad:.3f} rad about a second "
                f"axis, need {MIN_SPREAD_RAD} rad: {why}",
            )
        return None

    def described(self, describe: Describer) -> "ConePlan":
        """The plan with the margins of each pose."""
        return replace(self, poses=[replace(pose, checks=describe(pose.q)) for pose in self.poses])

    def as_dict(self) -> dict[str, Any]:
        """For journals and ``--dry-run``."""
        return {
            "axis": self.axis.label,
            "T_target_cone": [float(v) for v in to_pose6(self.axis.T_target_cone)],
            "candidates_tried": self.candidates_tried,
            "spread_rad": self.spread_rad,
            "travel_rad": self.travel_rad,
            "poses": [p.as_dict() for p in self.poses],
            "rejected": [{"index": r.index, "reason": r.reason} for r in self.rejected],
        }
