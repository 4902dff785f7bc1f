"""What an integrator can set for a latency calibration."""

from typing import Annotated, Literal

from pydantic import Field

from cell.formats.reading import Strict
from procedures.laser.config import Floor


class Acceptance(Strict):
    """Limits on the result; within them it may be accepted without a person when ``auto`` is set."""

    max_interval_s: float = Field(default=0.002, gt=0, le=1.0, description="width of the 95 % interval")
    max_offset_s: float = Field(
        default=0.1, gt=0, le=10.0, description="a greater delay is taken for a fault"
    )
    auto: bool = Field(default=False, description="accept a passing result without asking")


class LatencyCalibrationConfig(Strict):
    """``[job.latency-calibration]``. The tool, the beams and the way across are those of its reference."""

    source: Literal["beams"] = Field(
        default="beams", description="role of the device whose delay is measured"
    )
    beam: Literal["xs", "ys"] = Field(default="xs", description="the beam that is crossed")
    speeds_m_s: list[Annotated[float, Field(gt=0, le=0.5)]] = Field(
        default=[0.01, 0.02, 0.05],
        min_length=2,
        max_length=10,
        description="speeds of crossing; two that differ separate the delay from the hysteresis",
    )
    passes: int = Field(default=4, ge=2, le=64, description="there and back, at each speed")
    floor_m: Floor = None
    max_duration_s: float = Field(
        default=1800.0, gt=0, description="the run is ended when it takes longer, s"
    )
    accept: Acceptance = Field(default_factory=lambda: Acceptance(), description="who accepts the result")
