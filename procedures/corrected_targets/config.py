"""What an integrator can set for targets that are handed to an observed arm."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from cell.formats.bounds import Angle, LengthOrAngle
from procedures.laser_tracker.looking import Looking

Target = Annotated[list[LengthOrAngle], Field(min_length=4, max_length=6)]


class CorrectedTargetsConfig(Looking):
    """``[job.corrected-targets]``."""

    targets: list[Target] = Field(
        min_length=1,
        max_length=500,
        description="of the flange in the base: x, y, z (m) and yaw (rad) of a palletizer, else "
        "[x, y, z, rx, ry, rz]",
    )
    q_near: list[Angle] | None = Field(
        default=None,
        min_length=1,
        max_length=12,
        description="joints (rad) whose branch of the arm is used; else the middle of what was sampled",
    )
    as_given: bool = Field(
        default=True,
        description="ask for every target as given first: what is off then is what the correction is worth",
    )
    reflector: str | None = Field(
        default=None,
        min_length=1,
        description="on the flange, as the tracker's 'reflectors' name it and the calibration knows it; "
        "without it no tracker looks, and the joints alone say where the arm went",
    )
    max_error_m: float | None = Field(
        default=None, gt=0, le=0.1, description="limit of what remains off at a corrected target"
    )
    payload_kg: float | None = Field(
        default=None, ge=0, le=2000, description="on the flange now; it must be that of the calibration"
    )
    request_timeout_s: float = Field(
        default=120.0, gt=0, le=3600, description="for the arm's program to get to a target"
    )
    pose_tolerance_rad: float = Field(
        default=0.002,
        gt=0,
        le=1.0,
        description="an arm that rests further from the joints asked for is measured all the same, and told",
    )
    retries_per_target: int = Field(
        default=2, ge=0, le=10, description="further tries at a target that was not measured"
    )
    max_surprise_m: float = Field(
        default=0.03,
        gt=0,
        le=1.0,
        description="largest distance between where the reflector is seen and where it should be",
    )
    max_duration_s: float = Field(
        default=4 * 3600.0, gt=0, description="the run is ended when it takes longer, s"
    )

    @model_validator(mode="after")
    def _targets_are_whole(self) -> Self:
        for k, target in enumerate(self.targets):
            if len(target) == 5:
                raise ValueError(f"targets[{k}] has 5 numbers; give x, y, z, yaw or x, y, z, rx, ry, rz")
        return self
