"""What an integrator can set for the sampling of an arm with a laser tracker."""

from itertools import combinations, count
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from calibration.identification.selection import RULE_POSES
from cell.formats.bounds import Direction, Point, Pose
from cell.formats.reading import Strict
from procedures.laser_tracker.looking import Looking

Two = Annotated[list[float], Field(min_length=2, max_length=2)]


LEAST_WITH_SET = 3  # monuments: fewer do not show every way in which a stand can move


class Reflector(Strict):
    """A reflector on the flange. Its name is the one of ``[device.NAME] reflectors``."""

    point: Point = Field(description="m, in the flange; to about 20 mm, it is measured too")
    normal: Direction | None = Field(
        default=None, description="where it looks, in the flange; else everywhere"
    )
    half_angle_rad: float = Field(
        default=0.45, gt=0, le=np.pi, description="that the beam may come off normal; leave some room"
    )

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        if self.normal is not None and not np.linalg.norm(self.normal) > 0.0:
            raise ValueError("normal has no length; give the direction in which the reflector looks")
        return self


class Monument(Strict):
    """A reflector that is fixed to the floor or the base: it shows whether the tracker's stand moves."""

    point: Point = Field(description="m, in the base; to about 50 mm, its place is measured first")


class SightLimits(Strict):
    """Where the tracker can measure, and how far its beam has to stay from the arm."""

    range_m: Two = Field(default=[0.8, 30.0], description="least and greatest distance")
    elevation_rad: Two = Field(default=[-0.8, 1.2], description="lowest and highest beam at the tracker")
    clearance_m: float = Field(
        default=0.03,
        ge=0,
        le=0.5,
        description="between the beam and links, tool and keep-out boxes",
    )
    link_radius_m: float | None = Field(
        default=None,
        gt=0,
        le=1.0,
        description="of an observed arm's links, drawn along d and a of its table; without it only those of "
        "a UR are known to hide a reflector",
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for name in ("range_m", "elevation_rad"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"{name} is [low, high]; {low:g} is not below {high:g}")
        return self


class Acceptance(Strict):
    """Limits on the result; within them it may be accepted without a person when ``auto`` is set."""

    max_error_m: float = Field(
        default=0.0003, gt=0, le=0.1, description="95 % of prediction errors, anywhere that was sampled"
    )
    auto: bool = Field(default=False, description="accept a passing result without asking")


class TrackerSamplingConfig(Looking):
    """``[job.tracker-sampling]``."""

    arm: Literal["arm", "observed_arm"] = Field(
        default="arm", description="role in [robot]: the arm that is moved, or one that is only read"
    )
    reflectors: dict[str, Reflector] = Field(min_length=1, description="[..reflectors.NAME] on the flange")
    monuments: dict[str, Monument] = Field(default_factory=dict, description="[..monuments.NAME] in the base")
    poses: int = Field(default=40, ge=6, le=500, description="to measure, those set aside included")
    held_out_share: float = Field(
        default=0.2, ge=0, le=0.5, description="of the poses: set aside before solving, to judge the result"
    )
    keep_rule: bool = Field(
        default=False,
        description="plan by the rule of thumb: at least 50 poses to solve from, and every joint turns by "
        "more than 15 degrees from one of them to the next; no pose is measured where that cannot be had",
    )
    monument_every: int = Field(default=10, ge=1, le=500, description="poses between looks at the monuments")
    max_drift_m: float = Field(
        default=0.0001,
        gt=0,
        le=0.1,
        description="a monument further off than this, and than noise, moved",
    )
    T_base_tracker_nominal: Pose | None = Field(
        default=None,
        description="the tracker in the base, to its window of search; else the job asks",
    )
    locate_poses: int = Field(default=4, ge=3, le=20, description="to find the tracker's place with")
    max_locate_error_m: float = Field(
        default=0.02, gt=0, le=0.5, description="of the nominal arm at these poses, in its best place"
    )
    joint_ranges_rad: list[Two] | None = Field(
        default=None,
        description="[low, high] of each joint; else half a turn each way",
    )
    sight: SightLimits = Field(
        default_factory=lambda: SightLimits(),
        description="where the tracker must be able to see the reflectors",
    )
    constant_sigma_m: float = Field(
        default=0.00001,
        ge=0,
        le=0.05,
        description="how well the reflectors' constant is known: makers state 3 to 10 um for a ball, up to "
        "1 mm for a prism",
    )
    retries_per_pose: int = Field(
        default=2, ge=0, le=10, description="further tries at a pose that was not measured"
    )
    max_surprise_m: float = Field(
        default=0.05,
        gt=0,
        le=1.0,
        description="largest distance between where a reflector is seen and where it should be",
    )
    max_motion_m: float = Field(
        default=0.00005,
        gt=0,
        le=0.01,
        description="largest motion of the flange while a point is measured, by the joints",
    )
    swap_by_operator: bool = Field(
        default=False, description="there is one reflector, and a person puts it where the job asks"
    )
    request_timeout_s: float = Field(
        default=120.0, gt=0, le=3600, description="for an observed arm's program to get to a pose"
    )
    pose_tolerance_rad: float = Field(
        default=0.02,
        gt=0,
        le=1.0,
        description="an observed arm further off is measured all the same, and told",
    )
    payload_kg: float | None = Field(
        default=None,
        ge=0,
        le=2000,
        description="on the flange; else [robot] payload_kg, which it must equal",
    )
    max_predicted_m: float = Field(
        default=0.0003,
        gt=0,
        le=0.1,
        description="95 % of errors at the plan's worst place; beyond, nothing moves",
    )
    with_set: str | None = Field(
        default=None,
        description="kincal.json of an earlier run (its full path): its poses are solved together with these."
        " Same arm, reflectors and load, and monuments must show that the tracker was not moved since",
    )
    max_duration_s: float = Field(
        default=4 * 3600.0, gt=0, description="the run is ended when it takes longer, s"
    )
    accept: Acceptance = Field(
        default_factory=lambda: Acceptance(), description="who accepts the result, and its limits"
    )

    @property
    def held_out(self) -> int:
        """Poses that are set aside."""
        return round(self.poses * self.held_out_share)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if both := sorted(set(self.reflectors) & set(self.monuments)):
            raise ValueError(f"'{both[0]}' is a reflector and a monument; each needs a name of its own")
        for a, b in combinations(self.reflectors, 2):
            apart = float(np.linalg.norm(np.subtract(self.reflectors[a].point, self.reflectors[b].point)))
            if apart <= self.max_surprise_m:
                raise ValueError(
                    f"reflectors '{a}' and '{b}' are {1e3 * apart:.0f} mm apart, so one may be "
                    f"taken for the other with max_surprise_m = {self.max_surprise_m:g}; make that smaller"
                )
        if self.arm == "observed_arm" and self.joint_ranges_rad is None:
            raise ValueError("joint_ranges_rad is missing; an observed arm's joints have no known limits")
        if self.arm == "observed_arm" and self.payload_kg is None:
            raise ValueError("payload_kg is missing; [robot] payload_kg is that of the arm that is moved")
        if self.keep_rule and self.with_set is not None:
            raise ValueError("keep_rule is about the poses of one run; leave with_set out, or keep_rule")
        if self.keep_rule and self.poses - self.held_out < RULE_POSES:
            enough = next(n for n in count(self.poses) if n - round(n * self.held_out_share) >= RULE_POSES)
            raise ValueError(
                f"keep_rule asks for {RULE_POSES} poses to solve from, and poses = {self.poses} leaves "
                f"{self.poses - self.held_out}; make poses {enough}"
            )
        if self.with_set is not None and not Path(self.with_set).is_absolute():
            raise ValueError(f"with_set is '{self.with_set}'; give the full path of the file")
        if self.with_set is not None and len(self.monuments) < LEAST_WITH_SET:
            raise ValueError(
                f"with_set needs {LEAST_WITH_SET} monuments, which tell that the tracker still stands there"
            )
        for k, (low, high) in enumerate(self.joint_ranges_rad or ()):
            if not low <= high:
                raise ValueError(f"joint_ranges_rad[{k}] is [low, high]; {low:g} is above {high:g}")
        return self
