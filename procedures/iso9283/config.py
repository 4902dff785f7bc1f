"""What an integrator can set for the test of pose accuracy and repeatability."""

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from cell.formats.bounds import Point, Pose, Rotation
from cell.formats.reading import Strict
from procedures.laser_tracker.looking import Looking


class Cube(Strict):
    """The test cube of the standard, its edges along the base's axes, and the flange's attitude in it."""

    centre: Point = Field(description="of the cube, m in the base: where the reflector is at pose P1")
    edge_m: float = Field(gt=0, le=3.0, description="length of its edges")
    R_base_flange: Rotation = Field(description="rotation vector of the flange, the same at all poses")
    plane: Literal["+x", "-x", "+y", "-y"] = Field(
        default="+x", description="the poses lie on the diagonal plane that rises in this direction"
    )


class Iso9283Config(Looking):
    """``[job.iso9283]``: exactly one of ``cube`` and ``poses``."""

    reflector: str = Field(min_length=1, description="as the tracker's 'reflectors' name it")
    point: Point = Field(description="the reflector in the flange, m")
    cube: Cube | None = Field(default=None, description="in which the poses of the test lie")
    poses: list[Pose] | None = Field(
        default=None, min_length=5, max_length=5, description="P1 ... P5 as T_base_flange, instead of a cube"
    )
    near: str = Field(default="home", description="pose in [poses] whose branch of the arm is used")
    cycles: int = Field(default=30, ge=2, le=200, description="the standard has 30")
    speed_share: float = Field(default=1.0, gt=0, le=1.0, description="of the cell's limits of speed")
    corrected: bool | None = Field(
        default=None,
        description="command through the calibrated kinematics in effect: how good it makes the arm; else as "
        "[robot] use_kinematics says",
    )
    registration: Literal["fit", "kinematics"] = Field(
        default="fit",
        description="the tracker's place: the one that suits the poses best, or the calibration's",
    )
    T_base_tracker_nominal: Pose | None = Field(
        default=None, description="the tracker in the base, to 0.1 m and 2 deg; else a person points it"
    )
    window_s: float = Field(
        default=0.5, gt=0, le=60, description="length of the window whose readings make one stable point"
    )
    retries_per_pose: int = Field(
        default=2, ge=0, le=10, description="further tries at a pose that was not measured"
    )
    max_surprise_m: float = Field(
        default=0.05,
        gt=0,
        le=1.0,
        description="largest distance between where the reflector is seen and where it should be",
    )
    max_AP_m: float | None = Field(
        default=None,
        gt=0,
        le=0.1,
        description="limit of the pose accuracy AP of each pose; without it AP is only reported",
    )
    max_RP_m: float | None = Field(
        default=None,
        gt=0,
        le=0.1,
        description="limit of the pose repeatability RP of each pose; without it RP is only reported",
    )
    max_duration_s: float = Field(
        default=4 * 3600.0, gt=0, description="the run is ended when it takes longer, s"
    )

    @model_validator(mode="after")
    def _one_way_to_say_the_poses(self) -> Self:
        if (self.cube is None) == (self.poses is None):
            raise ValueError("give exactly one of 'cube' and 'poses'")
        if self.poses is not None:
            places = np.array(self.poses)[:, :3]
            if np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] < 0.02:
                raise ValueError("the poses lie on a line; the tracker's place cannot be found from them")
        return self
