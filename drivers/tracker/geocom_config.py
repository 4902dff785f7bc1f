"""What ``[device.tracker]`` in cell.toml may say with ``driver = "geocom"``."""

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from cell.laser_tracker import MOST_SIGMA0_M, MOST_SIGMA_PER_M
from drivers.tracker.address import TrackerAddress, parse_address
from drivers.tracker.config import TrackerConfig, TrackerSection


class ReflectorConfig(TrackerSection):
    """A prism or a ball-mounted reflector."""

    constant_m: float = Field(
        ge=-0.2, le=0.2, description="As the instrument takes it; written, and read back, when it is selected"
    )
    prism_type: int | None = Field(
        default=None,
        ge=0,
        le=100,
        description="Number of BAP_SetPrismType; the constant comes with it and is only compared. Absent: the"
        " constant alone is written",
    )


class GeocomConfig(TrackerConfig):
    """Keys of a device with ``driver = "geocom"``.

    These instruments are total stations, of 1 mm + 1.5 ppm class and with angles of an arc second or so. That
    shows a frame at the level of a millimetre; it is not the 15 micrometres of a laser tracker.
    """

    url: str = Field(
        description="tcp://host:port, or serial:///dev/ttyUSB1?baudrate=115200&parity=N&stopbits=1"
    )
    reflectors: dict[str, ReflectorConfig] = Field(
        min_length=1, description="By name, as in { smr1 = { constant_m = 0.0 } }"
    )
    sigma0_m: float = Field(
        default=1e-3,
        gt=0.0,
        le=MOST_SIGMA0_M,
        description="Standard deviation of a reading along one axis, at no range; the default is a station's",
    )
    sigma_per_m: float = Field(
        default=5e-6,
        ge=0.0,
        le=MOST_SIGMA_PER_M,
        description="What a metre of range adds to it; the default is an arc second",
    )
    expect_serial: str | None = Field(default=None, description="Serial number that the instrument must have")
    checksum: bool = Field(default=False, description="Send CRC16 with every request")
    reading: Literal["full", "simple", "coordinates"] = Field(
        default="full",
        description="full: TMC_GetFullMeas, with the time of the distance; simple: TMC_GetSimpleMea, for"
        " instruments that have no other; coordinates: TMC_GetCoordinate, less the station's own",
    )
    measure_with: Literal["single", "tracking"] = Field(
        default="single",
        description="Distances of a point: one measurement after the other, the most accurate, or those of"
        " tracking, the fastest",
    )
    tracking: Literal["rapid", "standard", "off"] = Field(
        default="rapid", description="Program of the distance meter between measurements, when locked"
    )
    edm_mode: int | None = Field(
        default=None,
        ge=0,
        le=20,
        description="Number of TMC_SetEdmMode, which says how single distances are measured; read back."
        " Absent: as it is set",
    )
    inclination: Literal["measure", "auto", "model"] = Field(
        default="auto", description="How the compensator is used"
    )
    temperature_c: float | None = Field(
        default=None, ge=-40.0, le=70.0, description="Of the air; written with pressure_pa and read back"
    )
    pressure_pa: float | None = Field(
        default=None,
        ge=50_000.0,
        le=120_000.0,
        description="of the air, for the correction of distances; with temperature_c",
    )
    search_window_rad: float = Field(
        default=0.035, gt=0.0, le=math.pi / 2, description="Width and height of the search for a reflector"
    )
    poll_period_s: float = Field(default=0.2, ge=0.02, le=5.0, description="time between two readings")
    timeout_s: float = Field(default=2.0, ge=0.05, le=30.0, description="Longest wait for one reply")
    distance_timeout_s: float = Field(default=6.0, ge=0.1, le=60.0, description="Longest single distance")
    motion_timeout_s: float = Field(
        default=30.0, ge=1.0, le=120.0, description="Longest turning and searching of the instrument"
    )
    lost_after_failures: int = Field(
        default=3, ge=1, le=20, description="Requests in a row without an answer that end the link"
    )

    @property
    def address(self) -> TrackerAddress:
        """Where the instrument is."""
        return parse_address(self.url)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        parse_address(self.url)
        if self.measure_with == "tracking" and self.tracking == "off":
            raise ValueError("measure_with = 'tracking' needs tracking = 'rapid' or 'standard'")
        if self.measure_with == "tracking" and self.reading == "simple":
            raise ValueError(
                "measure_with = 'tracking' needs reading = 'full' or 'coordinates', which tell a new distance"
                " from an old one"
            )
        if (self.temperature_c is None) != (self.pressure_pa is None):
            raise ValueError("temperature_c and pressure_pa are needed together")
        return self
