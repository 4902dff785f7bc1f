"""What an integrator can set for an eye-to-hand check."""

from typing import Literal, Self

from pydantic import Field, model_validator

from calibration.planning import Volume
from cell.formats.axbc import PlaceFrom
from cell.formats.bounds import Pose
from cell.formats.capture import CameraSigma
from cell.formats.reading import Strict
from procedures.hand_eye.config import ConeCaptureConfig

_SHARED = {
    "target",
    "camera_sigma",
    "start_pose",
    "settle_s",
    "frames_per_pose",
    "retries_per_pose",
    "min_corners",
    "seek_timeout_s",
    "max_duration_s",
}


class CheckAcceptance(Strict):
    """Limits of the given hand-eye, and who accepts what is proposed."""

    max_error_t_m: float = Field(
        default=0.001, gt=0, le=0.1, description="largest error of the given hand-eye, at the base"
    )
    max_error_r_rad: float = Field(default=0.001, gt=0, le=0.1, description="largest error of its rotation")
    auto: bool = Field(default=False, description="accept what a passing result proposes without asking")


class EyeToHandCheckConfig(Strict):
    """``[job.eye-to-hand-check]``."""

    target: str = Field(description="name of a [target.NAME] section; the target is on the flange")
    T_marker_flange: Pose = Field(
        description="the flange in the target, from a drawing or measured: x, y, z (m), rotation vector (rad)"
    )
    place_sigma_t_m: float = Field(
        1e-4, ge=0, le=0.1, description="how well that is known; its error is the same in all poses"
    )
    place_sigma_r_rad: float = Field(3e-4, ge=0, le=0.1, description="the same of its rotation")
    place_from: PlaceFrom = Field(
        "drawing",
        description="where T_marker_flange comes from; hand-eye: from a capture, by `cellward place`",
    )
    poses: int = Field(60, ge=10, le=60, description="how many, spread over what the camera sees")
    min_poses: int = Field(20, ge=10, le=60, description="fewer usable ones are no check")
    nearest_m: float = Field(0.4, gt=0.1, lt=5.0, description="camera to the target's centre, at least")
    farthest_m: float = Field(0.8, gt=0.1, lt=5.0, description="camera to the target's centre, at most")
    tilt_rad: float = Field(0.6, gt=0.1, lt=0.9, description="of the target from facing the camera, at most")
    propose: Literal["none", "camera", "constant", "kinematics"] = Field(
        "none",
        description="what a result offers: T_base_camera as it is, T_base_camera with the constant that "
        "corrects targets, or the arm's kinematics (use_kinematics); the last two where they correct targets "
        "better than anything simpler",
    )
    targets: list[Pose] = Field(
        default_factory=list,
        max_length=20,
        description="poses of the flange in the camera, as in a file of --targets: after the answer the arm "
        "is driven to each, as given and corrected, and the camera sees what is off",
    )
    camera_sigma: CameraSigma | None = Field(
        None, description="how well the intrinsics are known; else the lens is taken as it is given"
    )
    start_pose: str | None = Field(None, description="name of a [poses] entry; else where the arm stands")
    settle_s: float = Field(0.3, ge=0.0, le=10.0, description="wait at rest before the frames are taken")
    frames_per_pose: int = Field(5, ge=1, le=50, description="frames taken at each pose")
    retries_per_pose: int = Field(2, ge=0, le=10, description="further tries at a pose")
    min_corners: int | None = Field(
        None,
        ge=4,
        le=1000,
        description="points of the target that a frame must show; else 8, or all of a target that has fewer",
    )
    seek_timeout_s: float = Field(20.0, gt=0, le=600.0, description="longest wait until the target is seen")
    max_duration_s: float = Field(4 * 3600.0, gt=0, description="the run is ended when it takes longer, s")
    accept: CheckAcceptance = Field(
        default_factory=lambda: CheckAcceptance(), description="limits of the given hand-eye"
    )

    def capture(self) -> ConeCaptureConfig:
        """The steps of a capture with these settings: one placement of a target on the flange."""
        shared = self.model_dump(include=_SHARED)
        return ConeCaptureConfig.model_validate(
            {
                **shared,
                "setup": "eye-to-hand",
                "placements": 1,
                "poses_per_placement": self.poses,
                "min_poses_per_placement": self.min_poses,
            }
        )

    def volume(self) -> Volume:
        """What the poses are spread over."""
        return Volume(self.poses, self.nearest_m, self.farthest_m, self.tilt_rad)

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        if self.min_poses > self.poses:
            raise ValueError("min_poses is greater than poses")
        if self.nearest_m >= self.farthest_m:
            raise ValueError("nearest_m must be smaller than farthest_m")
        return self
