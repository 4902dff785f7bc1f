"""What ``cell.toml`` may say about a Universal Robots arm."""

from pydantic import Field

from cell.formats.reading import Strict
from drivers.life import TIME_OFFSET


class UrConfig(Strict):
    """Keys of a device with ``driver = "ur"``. The defaults suit an e-series arm."""

    host: str = Field(min_length=1, description="Address of the controller; the ports are UR's own")
    expect_serial: str | None = Field(default=None, description="Serial number that the controller must have")
    model: str | None = Field(default=None, description="Arm model that must be found, e.g. ur10e")
    rtde_frequency_hz: float = Field(
        default=500.0, ge=10.0, le=500.0, description="A CB3 controller gives 125 at most"
    )
    time_offset_s: float = Field(
        default=0.0,
        ge=-0.1,
        le=0.1,
        description=TIME_OFFSET,
    )
    connect_timeout_s: float = Field(
        default=3.0, gt=0.0, le=30.0, description="longest wait for a connection, s"
    )
    stale_after_s: float = Field(default=0.02, gt=0.0, le=1.0, description="Older state forbids motion")
    silent_after_s: float = Field(
        default=0.1, gt=0.0, le=1.0, description="Silence at which an arm that moves is stopped"
    )
    lost_after_s: float = Field(default=0.5, gt=0.0, le=5.0, description="Silence that ends the link")
    joint_tolerance_rad: float = Field(
        default=0.001, gt=0.0, le=0.05, description="a move has arrived when each joint is this close"
    )
    position_tolerance_m: float = Field(
        default=0.0005, gt=0.0, le=0.01, description="a linear move has arrived when the TCP is this close"
    )
    rotation_tolerance_rad: float = Field(
        default=0.001,
        gt=0.0,
        le=0.05,
        description="a linear move has arrived when the TCP's rotation is this close",
    )
    stop_decel_m_s2: float = Field(
        default=5.0,
        gt=0.0,
        le=50.0,
        description="Of a stop; a move that brakes harder is stopped as hard as it brakes itself",
    )
    follow_decel_rad_s2: float = Field(
        default=8.0, gt=0.0, le=40.0, description="Ramp at the end of a stream"
    )
    servo_lookahead_s: float = Field(
        default=0.05, ge=0.03, le=0.2, description="lookahead_time of servoj while the arm follows a stream"
    )
    servo_gain: float = Field(
        default=500.0, ge=100.0, le=2000.0, description="gain of servoj while the arm follows a stream"
    )
    watchdog_min_hz: float = Field(
        default=10.0, ge=5.0, le=50.0, description="The controller stops the arm when kicks come slower"
    )
