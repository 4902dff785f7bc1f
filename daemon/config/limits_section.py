"""``[limits]``: what every motion keeps to."""

from typing import ClassVar, Self

from pydantic import Field, model_validator

from cell.formats.joint_limits import JointRanges, JointSpeeds
from daemon.config.section import GrownSection, Point, Section


class Box(Section):
    """An axis-parallel box in the base frame, m."""

    min: Point = Field(description="lowest corner x, y, z in the base, m")
    max: Point = Field(description="highest corner x, y, z in the base, m")

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if any(low >= high for low, high in zip(self.min, self.max, strict=True)):
            raise ValueError("each number of 'min' must be smaller than that of 'max'")
        return self


class KeepOutBox(Box):
    """A box that tool and links must not enter."""

    name: str = Field(min_length=1, description="shown when a move would enter it")


class LimitsSection(GrownSection):
    """Limits of every motion. Safety limits belong in the robot's own safety configuration."""

    LATER: ClassVar = frozenset({"joint_ranges_rad"})

    speed_m_s: float = Field(default=0.25, ge=0.001, le=5.0, description="highest speed of the tool")
    accel_m_s2: float = Field(default=0.5, gt=0, le=50.0, description="highest acceleration of the tool")
    joint_speed_rad_s: JointSpeeds = Field(
        default=0.8, description="highest speed of each joint: one number, or six from the base to the flange"
    )
    joint_ranges_rad: JointRanges | None = Field(
        default=None,
        description="lowest and highest angle of each joint, base to flange, within what the arm can; "
        "without it those that the arm's controller tells",
    )
    joint_accel_rad_s2: float = Field(
        default=1.4, gt=0, le=80.0, description="highest acceleration of each joint"
    )
    allow_job_override: bool = Field(
        default=False, description="a job may raise limits; the dry run shows it"
    )
    workspace: list[Box] = Field(
        default_factory=list, description="the tool stays within these boxes; an arm needs one at least"
    )
    keep_out: list[KeepOutBox] = Field(
        default_factory=list, description="boxes that tool and links must not enter"
    )
