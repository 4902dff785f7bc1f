"""What a planned placement is expected to tell, with the priors that the result will be solved with."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calibration.adjustment.arm_accuracy import position_metric
from calibration.adjustment.prediction import ExpectedCovariance, PlannedViews, expected
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye.problem import Setup
from calibration.kinematics.families import arm_spec
from calibration.kinematics.parametric import ParametricArm
from calibration.planning import ConePlan, Mounting, PredictedUncertainty
from cell.devices import Intrinsics
from cell.formats.robot import parse_robot
from cell.poses import Array
from cell.run_values import RunValues
from procedures.arm_setup import arm_robot
from procedures.hand_eye.budget import by_cause, largest
from procedures.hand_eye.known_parts import KnownParts, known_parts

# What a prediction assumes before anything was measured; said beside it. A corner is the mean of a pose's
# frames: in one frame real boards scatter by 0.15 to 0.3 px, and a pose has five unless configured.
ASSUMED = {"sigma_px": 0.1, "sigma_flange_t": 5e-5, "sigma_flange_r": 5e-5}
_MANY = 10_000  # placements: what is left then is what no number of them tells
_JOINTS = 6


@dataclass(frozen=True)
class CapturePrediction:
    """The adjustment of a run as it is known before it: what is seen, by what, and how well that is known."""

    setup: Setup
    mounting: Mounting
    camera: Intrinsics
    points: Array
    values: RunValues
    known: KnownParts
    placements: int

    @classmethod
    def of(
        cls,
        setup: Setup,
        mounting: Mounting,
        camera: Intrinsics,
        points: Array,
        values: RunValues,
        target: dict[str, Any],
        camera_sigma: dict[str, float] | None,
        placements: int,
    ) -> "CapturePrediction":
        """``target`` and ``camera_sigma`` as in the data set that the run will write."""
        robot = parse_robot(arm_robot(values), "robot")
        adjustable = robot if arm_spec(robot, "robot").arm.joints == _JOINTS else None
        known = known_parts(target, camera_sigma, adjustable)
        return cls(setup, mounting, camera, points, values, known, placements)

    def error_at(self, plan: ConePlan, distance_m: float) -> float:
        """Expected error (m, RMS) of a point that far before the camera, by the corrected arm anywhere."""
        found = self._expected(plan, self.placements)
        sure = PredictedUncertainty(found.cov)
        return float(
            np.linalg.norm([sure.sigma_t_m, distance_m * sure.sigma_r_rad, self._arm_left(found) or 0.0])
        )

    def told(self, plan: ConePlan) -> dict[str, Any]:
        """The 95 % errors, by cause, what each part will be known to, what no further placement lowers, and
        what was assumed."""
        found, limit = self._expected(plan, self.placements), self._expected(plan, _MANY)
        sure, at_best, left = (
            PredictedUncertainty(found.cov),
            PredictedUncertainty(limit.cov),
            by_cause(limit.budget),
        )
        return {
            "error95_t_m": sure.error95_t_m,
            "error95_r_rad": sure.error95_r_rad,
            "budget": by_cause(found.budget),
            "known": self._parts(found),
            "limit": {
                "error95_t_m": at_best.error95_t_m,
                "error95_r_rad": at_best.error95_r_rad,
                "block_t": largest(left, "t"),
                "block_r": largest(left, "r"),
                "known": self._parts(limit),
            },
            "assuming": {**ASSUMED, "placements": self.placements},
            "priors": dict(self.known.sources),
        }

    def _parts(self, found: ExpectedCovariance) -> dict[str, float]:
        """Standard uncertainties: lens and print as shares, px and m; the arm's places over its joints, m."""
        sigma = found.sigma
        parts = {
            "focal": sigma["focal"],
            "centre_px": max(sigma["cx"], sigma["cy"]),
            "scale": max(sigma["scale_x"], sigma["scale_y"]),
            "bow_m": max(sigma["bow_xx"], sigma["bow_xy"], sigma["bow_yy"]),
        }
        left = self._arm_left(found)
        return parts if left is None else parts | {"arm_m": left}

    def _arm_left(self, found: ExpectedCovariance) -> float | None:
        """RMS position error (m) of the corrected arm over its joints; None where it is taken as exact."""
        if self._metric is None:
            return None
        return float(np.sqrt(np.sum(self._metric * found.cov_arm)))

    @cached_property
    def _metric(self) -> Array | None:
        arm = self._arm(np.zeros((1, _JOINTS)))
        return None if arm is None else position_metric(arm)

    def _arm(self, Q: Array) -> ArmKnown | None:
        """The arm at joints ``Q`` (n, 6), None where its errors are no unknowns."""
        if self._model is None:
            return None
        limits = np.tile([-np.pi, np.pi], (_JOINTS, 1))
        return ArmKnown(self._model, Q, limits, self.known.arm, scale_free=False)

    @cached_property
    def _model(self) -> ParametricArm | None:
        if "arm" not in self.known.sources:
            return None
        return arm_spec(parse_robot(arm_robot(self.values), "robot"), "robot").arm

    def _expected(self, plan: ConePlan, placements: int) -> ExpectedCovariance:
        F = np.stack([p.T_base_flange.as_matrix() for p in plan.poses])
        C = np.stack([p.T_camera_target.as_matrix() for p in plan.poses])
        views = PlannedViews(F, C, self.mounting.X.as_matrix(), self.points)
        arm, known = self._arm(np.stack([p.q for p in plan.poses])), self.known
        return expected(self.setup, views, self.camera, ASSUMED, arm, known.lens, known.target, placements)
