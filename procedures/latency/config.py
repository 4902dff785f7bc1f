"""What an integrator can set for a latency calibration."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cell.formats.reading import Strict
from procedures.belt.config import ItemLook
from procedures.laser.config import Floor

SPEEDS_M_S = {"beams": [0.01, 0.02, 0.05]}
OF_A_CAMERA = [0.05, 0.1, 0.2]
BEAMS_INTERVAL_S = 0.006


class Acceptance(Strict):
    """Limits on the result; within them it may be accepted without a person when ``auto`` is set."""

    max_interval_s: float = Field(
        default=0.002,
        gt=0,
        le=1.0,
        description="width of the 95 % interval; absent with beams: 0.006, as their jobs pass there and "
        "back, by which a delay cancels",
    )
    max_offset_s: float = Field(
        default=0.1, gt=0, le=10.0, description="a greater delay is taken for a fault"
    )
    auto: bool = Field(default=False, description="accept a passing result without asking")


class LatencyCalibrationConfig(Strict):
    """``[job.latency-calibration]``. For beams, the tool and the way across are those of its reference."""

    source: Literal["beams", "flange_camera", "fixed_camera", "belt"] = Field(
        default="beams",
        description="role of the device whose delay is measured; of the belt, the encoder's, by the fixed "
        "camera above it, whose own delay has to be known",
    )
    beam: Literal["xs", "ys"] = Field(default="xs", description="beams: the beam that is crossed")
    speeds_m_s: list[Annotated[float, Field(gt=0, le=0.5)]] | None = Field(
        default=None,
        min_length=2,
        max_length=10,
        description="beams and cameras: speeds of the way; two that differ separate the delay from the "
        "hysteresis. Absent: 0.01, 0.02, 0.05 for beams, 0.05, 0.1, 0.2 for a camera",
    )
    passes: int = Field(
        default=4, ge=2, le=64, description="beams and cameras: there and back, at each speed"
    )
    floor_m: Floor = None
    target: str | None = Field(
        default=None, description="cameras: name of a [target.NAME] section with numbered points"
    )
    pose: str | None = Field(
        default=None,
        description="cameras: name of a [poses] entry, in the middle of the way, with the target in view; "
        "absent: where the arm stands",
    )
    way_m: float = Field(
        default=0.2, gt=0.01, le=1.0, description="cameras: length of the way, along the picture's rows"
    )
    settle_s: float = Field(
        default=0.3, ge=0.1, le=10.0, description="cameras: recorded at rest before and after each way"
    )
    belt_z_m: float | None = Field(
        default=None, ge=-5, le=5, description="belt: height of the belt's surface in the base"
    )
    items: ItemLook = Field(default_factory=ItemLook, description="belt: how items look from the camera")
    changes: int = Field(
        default=20, ge=4, le=1000, description="belt: wait for so many starts and stops of it, together"
    )
    sightings: int = Field(
        default=120, ge=30, le=20000, description="belt: and for so many sightings of items"
    )
    patience_s: float = Field(
        default=60.0, gt=0, le=3600, description="belt: wait so long for the next start or stop"
    )
    max_duration_s: float = Field(
        default=1800.0, gt=0, description="the run is ended when it takes longer, s"
    )
    accept: Acceptance = Field(default_factory=lambda: Acceptance(), description="who accepts the result")

    @property
    def speeds(self) -> list[float]:
        """Of the ways, m/s; none where the arm stands still."""
        if self.source == "belt":
            return []
        return self.speeds_m_s or SPEEDS_M_S.get(self.source, OF_A_CAMERA)

    @model_validator(mode="after")
    def _limit_of_beams(self) -> Self:
        """A module that answers in 2.5 ms leaves 4.5 ms open, however often a beam is crossed."""
        if self.source == "beams" and "max_interval_s" not in self.accept.model_fields_set:
            accept = self.accept.model_copy(update={"max_interval_s": BEAMS_INTERVAL_S})
            object.__setattr__(self, "accept", accept)
        return self

    @model_validator(mode="after")
    def _has_what_its_source_needs(self) -> Self:
        if self.source.endswith("_camera") and self.target is None:
            raise ValueError(
                f"target is needed with source = '{self.source}': the [target.NAME] that is seen"
            )
        if self.source == "belt" and self.belt_z_m is None:
            raise ValueError("belt_z_m is needed with source = 'belt': the height of the belt in the base")
        return self
