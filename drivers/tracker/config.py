"""What the device sections of all trackers have in common."""

from pydantic import Field

from cell.formats.reading import Strict
from drivers.life import TIME_OFFSET


class TrackerSection(Strict):
    """Unknown keys are errors; lengths in metres, angles in radians."""


class TrackerConfig(TrackerSection):
    """Keys of every tracker."""

    min_readings: int = Field(
        default=3, ge=2, le=1000, description="A point is the mean of so many readings at least"
    )
    time_offset_s: float = Field(
        default=0.0,
        ge=-0.5,
        le=5.0,
        description=TIME_OFFSET,
    )
    connect_timeout_s: float = Field(
        default=3.0, gt=0.0, le=15.0, description="longest wait for a connection, s"
    )
