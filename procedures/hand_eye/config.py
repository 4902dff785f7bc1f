"""What an integrator can set for a cone-pose capture."""

from typing import Literal, Self

from pydantic import Field, model_validator

from cell.formats.capture import CameraSigma
from cell.formats.reading import Strict

ENOUGH_CORNERS = 8  # of a board: twice what a pose needs, so that some may be hidden


class Acceptance(Strict):
    """Limits on the result; within them it may be accepted without a person when ``auto`` is set."""

    max_error_t_m: float = Field(default=0.0005, gt=0, le=0.1, description="95 % error of X, translation")
    max_error_r_rad: float = Field(
        default=0.002,
        gt=0,
        le=0.1,
        description="95 % error of X, rotation; a principal point that is 1 px off turns X by 1 px / f",
    )
    max_spread_within_t_m: float | None = Field(
        default=None,
        gt=0,
        le=1.0,
        description="unweighted spread within placements, translation; without it the spread is shown and "
        "not judged",
    )
    max_spread_within_r_rad: float | None = Field(
        default=None, gt=0, le=1.0, description="unweighted spread within placements, rotation"
    )
    max_spread_across_t_m: float | None = Field(
        default=None, gt=0, le=1.0, description="unweighted spread across placements, translation"
    )
    max_spread_across_r_rad: float | None = Field(
        default=None, gt=0, le=1.0, description="unweighted spread across placements, rotation"
    )
    task_pose: str | None = Field(
        default=None,
        description="name of a [poses] entry where the result is to be used; its accuracy there is predicted",
    )
    task_distance_m: float | None = Field(
        default=None, gt=0, le=10.0, description="camera to what it looks at there; else distance_m"
    )
    clearance_m: float | None = Field(
        default=None,
        gt=0,
        le=0.1,
        description="what the task leaves free on each side; at task_pose 95 % of the errors must stay below",
    )
    auto: bool = Field(default=False, description="accept a passing result without asking")

    @model_validator(mode="after")
    def _task_has_a_place(self) -> Self:
        if self.task_pose is None and not (self.clearance_m is None and self.task_distance_m is None):
            raise ValueError("clearance_m and task_distance_m need task_pose, the place that they are for")
        return self


def corners_needed(min_corners: int | None, points: int) -> int:
    """How many of a target's ``points`` a frame must show."""
    return min(ENOUGH_CORNERS, points) if min_corners is None else min_corners


class ConeCaptureConfig(Strict):
    """``[job.cone-capture]``."""

    target: str = Field(description="name of a [target.NAME] section")
    setup: Literal["eye-in-hand", "eye-to-hand"] = Field(
        default="eye-in-hand",
        description="where the camera is: on the flange, or fixed and the target on the flange",
    )
    placements: int = Field(10, ge=1, le=60, description="how often the board is placed anew")
    bases: int | None = Field(
        None,
        ge=1,
        le=60,
        description="places of the board's stand; with it placements are bases x tilts, and are not given",
    )
    tilts: int = Field(1, ge=1, le=20, description="tilts of the board on its stand at each of the bases")
    poses_per_placement: int = Field(20, ge=3, le=60, description="an even number balances the cone")
    min_poses_per_placement: int = Field(
        3,
        ge=3,
        le=60,
        description="a placement with fewer usable poses does not count, and is asked for again",
    )
    new_place_t_m: float = Field(
        0.01,
        gt=0,
        le=0.5,
        description="a board that moved less, and turned less than new_place_r_rad, "
        "since an earlier placement counts as not moved",
    )
    new_place_r_rad: float = Field(0.035, gt=0, le=1.0, description="see new_place_t_m")
    cone_half_angle_rad: float = Field(
        0.44, gt=0.1, lt=1.0, description="between the cone's axis and the poses on it"
    )
    distance_m: float = Field(0.5, gt=0.1, lt=3.0, description="camera to board centre")
    second_distance_m: float | None = Field(
        None,
        gt=0.1,
        lt=3.0,
        description="of every other pose, which parts focal length and printed size; "
        "else the one that tells most",
    )
    camera_sigma: CameraSigma | None = Field(
        None,
        description="how well the camera's intrinsics are known; else as a maker's own calibration",
    )
    start_pose: str | None = Field(
        None, description="name of a [poses] entry where each placement starts; else where the arm stands"
    )
    settle_s: float = Field(0.3, ge=0.0, le=10.0, description="wait at rest before the frames are taken")
    frames_per_pose: int = Field(5, ge=1, le=50, description="frames taken at each pose")
    retries_per_pose: int = Field(
        2, ge=0, le=10, description="further tries at a pose whose frames cannot be used"
    )
    min_corners: int | None = Field(
        None,
        ge=4,
        le=1000,
        description="board corners a frame must show; else 8, or all of a target that has fewer",
    )
    max_flange_motion_m: float = Field(
        0.0001, gt=0, le=0.01, description="largest motion of the flange while the frames are taken"
    )
    max_corner_motion_px: float = Field(
        0.5, gt=0, le=10.0, description="largest shift of a corner between frames of one pose"
    )
    seek_timeout_s: float = Field(
        20.0, gt=0, le=600.0, description="longest wait until the camera sees the target"
    )
    max_duration_s: float = Field(4 * 3600.0, gt=0, description="the run is ended when it takes longer, s")
    accept: Acceptance = Field(
        default_factory=lambda: Acceptance(), description="95 % limits of the result and who accepts it"
    )

    def pictures(self) -> int:
        """Frames of a run that takes every pose at the first attempt."""
        return self.placements * self.poses_per_placement * self.frames_per_pose

    def sigma_of_camera(self) -> dict[str, float] | None:
        """``camera.sigma`` of the data set."""
        return None if self.camera_sigma is None else self.camera_sigma.model_dump(exclude_none=True)

    @model_validator(mode="after")
    def _bases_x_tilts(self) -> Self:
        if self.bases is None:
            if self.tilts != 1:
                raise ValueError("tilts needs bases: the placements are bases x tilts")
            return self
        wanted = self.bases * self.tilts
        if "placements" in self.model_fields_set and self.placements != wanted:
            raise ValueError(
                f"placements is {self.placements}, bases x tilts is {wanted}; leave placements out"
            )
        if wanted > 60:
            raise ValueError(f"bases x tilts is {wanted}; at most 60 placements are taken")
        object.__setattr__(self, "placements", wanted)  # the model is frozen for everybody else
        return self

    @model_validator(mode="after")
    def _enough_poses(self) -> Self:
        if self.min_poses_per_placement > self.poses_per_placement:
            raise ValueError("min_poses_per_placement is greater than poses_per_placement")
        return self
