"""What ``[device.belt]`` in cell.toml may say."""

from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from cell.formats.reading import Strict
from drivers.can_bus.address import BusAddress, parse_bus
from drivers.life import TIME_OFFSET

FRAME_BITS = 135  # of eight bytes and an 11-bit identifier with the most stuff bits (Bosch, CAN 2.0)
MOST_LOAD = 0.7  # of the bus by one encoder; others have to be heard too


class BusConfig(Strict):
    """Keys that every encoder on CAN has."""

    bus: str = Field(
        description="socketcan:can0, slcan:/dev/ttyACM0@250000 or socketcand:host:29536/can0;"
        " the number behind the @ is the bit rate of the bus"
    )
    expect_serial: str | None = Field(default=None, description="Serial number that the encoder must have")
    period_s: float = Field(default=0.005, ge=0.001, le=1.0, description="Interval of the position frames")
    lost_after_s: float = Field(
        default=0.25, ge=0.02, le=10.0, description="So long without a position ends the link"
    )
    connect_timeout_s: float = Field(
        default=3.0, gt=0.0, le=15.0, description="longest wait for a connection, s"
    )
    time_offset_s: float = Field(
        default=0.0,
        ge=-0.1,
        le=0.1,
        description=TIME_OFFSET,
    )

    @field_validator("bus")
    @classmethod
    def _is_a_place(cls, value: str) -> str:
        parse_bus(value)
        return value

    @model_validator(mode="after")
    def _watch_is_slower_than_the_frames(self) -> Self:
        if self.lost_after_s < 3.0 * self.period_s:
            raise ValueError(f"lost_after_s = {self.lost_after_s:g} should be three times period_s or more")
        return self

    @model_validator(mode="after")
    def _bus_carries_the_frames(self) -> Self:
        rate = parse_bus(self.bus).bit_rate
        if rate and (share := FRAME_BITS / self.period_s / rate) > MOST_LOAD:
            raise ValueError(
                f"period_s = {self.period_s:g}: its position frames alone would fill {100 * share:.0f} % of "
                f"a bus with {rate} bit/s; make period_s longer or the bus faster, "
                f"{100 * MOST_LOAD:.0f} % are the most"
            )
        return self

    @property
    def address(self) -> BusAddress:
        """Where the bus is."""
        return parse_bus(self.bus)


class CanopenEncoderConfig(BusConfig):
    """Keys of a device with ``driver = "canopen-encoder"``."""

    node: int = Field(default=1, ge=1, le=127, description="CANopen node number")
    tpdo: Literal[1, 2] = Field(default=1, description="The process data object that carries the position")
    cob_id: int | None = Field(
        default=None, ge=0x181, le=0x57F, description="Its CAN identifier; absent: 180h or 280h plus the node"
    )
    speed: bool = Field(default=False, description="Send the encoder's own speed too; it is shown in health")
    heartbeat_s: float = Field(
        default=0.2, ge=0.0, le=10.0, description="Interval of the node's heartbeat; 0 switches it off"
    )
    units_per_revolution: int | None = Field(
        default=None,
        ge=1,
        le=0xFFFFFFFF,
        description="Written to 6001h with scaling on; absent: left as it is",
    )
    range_counts: int | None = Field(
        default=None,
        ge=2,
        le=1 << 32,
        description="Written to 6002h with scaling on: the count goes back to 0 there; absent: left as it is",
    )

    @model_validator(mode="after")
    def _milliseconds(self) -> Self:
        for key in ("period_s", "heartbeat_s"):
            milliseconds = 1000.0 * getattr(self, key)
            if abs(milliseconds - round(milliseconds)) > 1e-6:
                raise ValueError(f"{key} = {getattr(self, key):g} is no whole number of milliseconds")
        return self

    @property
    def position_id(self) -> int:
        """CAN identifier of the position frames."""
        return self.cob_id or (0x80 + 0x100 * self.tpdo + self.node)


class RawCanEncoderConfig(BusConfig):
    """Keys of a device with ``driver = "raw-can-encoder"``: an encoder that talks by itself."""

    id: int = Field(ge=0, le=0x1FFFFFFF, description="CAN identifier of its frames")
    extended: bool = Field(default=False, description="The identifier has 29 bits")
    offset_bytes: int = Field(default=0, ge=0, le=7, description="Where the position begins in the data")
    width_bits: Literal[8, 16, 24, 32, 40, 48, 56, 64] = Field(
        default=32, description="of the position in the frame"
    )
    byte_order: Literal["little", "big"] = Field(default="little", description="of the position in the frame")
    signed: bool = Field(default=False, description="the position is a signed number")
    range_counts: int | None = Field(
        default=None, ge=2, le=1 << 64, description="The count goes back to 0 there; absent: 2 to the width"
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.extended and self.id > 0x7FF:
            raise ValueError(f"id {self.id:#x} has more than 11 bits; set extended = true")
        if 8 * self.offset_bytes + self.width_bits > 64:
            raise ValueError(
                f"offset_bytes = {self.offset_bytes} and width_bits = {self.width_bits} go beyond 8 bytes"
            )
        if self.range_counts is not None and self.range_counts > 1 << self.width_bits:
            raise ValueError(f"range_counts = {self.range_counts} does not fit {self.width_bits} bits")
        if self.signed and self.range_counts not in (None, 1 << self.width_bits):
            raise ValueError("a signed position wraps at its width; leave range_counts out")
        return self

    @property
    def modulus(self) -> int:
        return self.range_counts or 1 << self.width_bits
