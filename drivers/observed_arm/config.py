"""What the section of an observed arm in cell.toml may say."""

from itertools import pairwise
from typing import Annotated, Self
from urllib.parse import urlsplit

from pydantic import Field, model_validator

from cell.formats.reading import Strict
from drivers.life import TIME_OFFSET
from drivers.modbus.address import parse_url
from drivers.modbus.link import LinkSettings
from drivers.modbus.registers import RegisterTable, SerialConfig, WordOrder
from drivers.observed_arm.numbers import WORDS, Encoding, NumberType, Unit

Address = Annotated[int, Field(ge=0, le=65535)]


class JointConfig(Strict):
    """One joint: where it is found, and what the number there means."""

    address: Address | None = Field(default=None, description="First register; for a url with registers")
    table: RegisterTable = Field(default="holding", description="Modbus table of the joint")
    type: NumberType = Field(default="float32", description="how the registers hold the number")
    word_order: WordOrder = Field(default="high-first", description="of the joint's two registers")
    column: str | None = Field(default=None, min_length=1, description="For a file; absent: q1, q2, ...")
    unit: Unit = Field(default="rad", description="counts: of the joint's own encoder, see counts_per_turn")
    scale: float = Field(default=1.0, gt=0.0, le=1e6, description="Units for one step of the number")
    counts_per_turn: float | None = Field(
        default=None, description="Counts of one full turn of the joint, negative if it counts backwards"
    )
    zero: float = Field(default=0.0, description="The number when the joint is at zero")

    @model_validator(mode="after")
    def _counts_have_a_ratio(self) -> Self:
        if (self.unit == "counts") != (self.counts_per_turn is not None):
            raise ValueError('unit = "counts" and counts_per_turn belong together: give both or neither')
        if self.counts_per_turn is not None and abs(self.counts_per_turn) < 1.0:
            raise ValueError(f"counts_per_turn = {self.counts_per_turn:g} is less than one count a turn")
        return self

    @property
    def encoding(self) -> Encoding:
        """How to read and write it."""
        return Encoding(
            self.type, self.word_order == "low-first", self.unit, self.scale, self.counts_per_turn, self.zero
        )


class BitConfig(Strict):
    """One bit of a register."""

    table: RegisterTable = Field(default="holding", description="Modbus table of the bit")
    address: Address = Field(description="where the bit is")
    bit: int = Field(default=0, ge=0, le=15, description="0 is the lowest")
    invert: bool = Field(default=False, description="The bit is set while the arm stands")


class HandshakeConfig(Strict):
    """Holding registers through which the arm's own program is asked for a pose and says where it stands."""

    targets: list[Address] = Field(
        min_length=1, description="First register of each joint that is asked for; numbers as of the joints"
    )
    number: Address = Field(description="Number of the pose that is asked for; 0 takes a request back")
    reached: Address | None = Field(
        default=None, description="Number of the pose at which the program says the arm stands; 0 for none"
    )


class ObservedArmConfig(Strict):
    """Keys of a device with ``driver = "observed-arm"``."""

    url: str = Field(
        description="tcp://host:port or rtu:///dev/ttyUSB0?baudrate=115200 for Modbus registers,"
        " file:///path/joints.csv for a file that grows by one row at each rest"
    )
    joints: list[JointConfig] = Field(
        min_length=1,
        max_length=12,
        description="In the order of the arm's model, as in [{ address = 0, unit = 'deg' }]; joint = (number"
        " - zero) * scale * unit. type: float32, int32 or int16; word_order: high-first or low-first; unit:"
        " rad, deg, m, mm, or counts with counts_per_turn; column: in a file, else q1, q2, ...",
    )
    unit: int = Field(default=1, ge=0, le=255, description="Unit identifier of the controller")
    moving: BitConfig | None = Field(default=None, description="A bit that says whether the arm moves")
    handshake: HandshakeConfig | None = Field(
        default=None, description="Holding registers between us and the arm's own program"
    )
    allow_requests: bool = Field(
        default=False,
        description="Write what a job asks for into the handshake's registers; the arm's own controller and"
        " its operator decide what comes of it. false: nothing is ever written",
    )
    rest_window_s: float = Field(
        default=0.5, gt=0.0, le=30.0, description="The arm rests when its joints have kept still for so long"
    )
    rest_spread_rad: float = Field(
        default=1e-4,
        gt=0.0,
        le=0.1,
        description="Joints that stay within this keep still (m for a sliding joint)",
    )
    poll_period_s: float = Field(
        default=0.05, ge=0.005, le=1.0, description="time between two readings of the joints"
    )
    timeout_s: float = Field(default=0.2, ge=0.005, le=5.0, description="Longest wait for one reply")
    connect_timeout_s: float = Field(
        default=3.0, gt=0.0, le=15.0, description="longest wait for a connection, s"
    )
    lost_after_failures: int = Field(
        default=3, ge=1, le=20, description="Polls in a row without an answer that end the link"
    )
    time_offset_s: float = Field(default=0.0, ge=-5.0, le=5.0, description=TIME_OFFSET)
    model: str = Field(default="observed arm", min_length=1, description="What it is, if it cannot tell")
    serial: SerialConfig | None = Field(
        default=None, description="Where the serial number is, if function 43 does not tell it"
    )
    stated_serial: str | None = Field(
        default=None, description="The serial number, if the arm cannot tell it at all"
    )
    expect_serial: str | None = Field(default=None, description="Serial number that the arm must have")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.rest_window_s < 2.0 * self.poll_period_s:
            raise ValueError(
                f"rest_window_s = {self.rest_window_s:g} should be at least twice poll_period_s ="
                f" {self.poll_period_s:g}"
            )
        if self.is_file:
            self._check_file()
        else:
            self._check_registers()
        return self

    @property
    def is_file(self) -> bool:
        return urlsplit(self.url).scheme == "file"

    @property
    def path(self) -> str:
        """The file of ``file:///...``."""
        return urlsplit(self.url).path

    @property
    def columns(self) -> list[str]:
        """The file's column of each joint."""
        return [joint.column or f"q{i}" for i, joint in enumerate(self.joints, 1)]

    @property
    def link(self) -> LinkSettings:
        """How to connect."""
        return LinkSettings(
            url=self.url,
            address=parse_url(self.url),
            unit=self.unit,
            timeout_s=self.timeout_s,
            connect_timeout_s=self.connect_timeout_s,
            keys="unit, and table and address of joints, moving and handshake",
        )

    def _check_file(self) -> None:
        parts = urlsplit(self.url)
        if parts.netloc or not parts.path.startswith("/") or parts.path.endswith("/"):
            raise ValueError(f"url '{self.url}' should be file:///path/joints.csv, with three slashes")
        for key in ("moving", "handshake", "serial"):
            if getattr(self, key) is not None:
                raise ValueError(f"{key} is about registers; {self.url} has none")
        if self.allow_requests:
            raise ValueError(f"allow_requests is about registers; {self.url} has none")
        if any(joint.address is not None for joint in self.joints):
            raise ValueError("address is about registers; a joint in a file has a column")
        names = [*self.columns, "t", "pose"]
        if len(set(names)) != len(names):
            raise ValueError(f"columns should differ from each other, and from t and pose; got {names[:-2]}")

    def _check_registers(self) -> None:
        if parse_url(self.url).scheme == "tls":
            raise ValueError(f"url '{self.url}' should begin with tcp://, rtu:// or file://")
        for i, joint in enumerate(self.joints, 1):
            if joint.address is None or joint.column is not None:
                raise ValueError(f"joint {i} has no address, or a column; it is in registers here")
        if self.allow_requests and self.handshake is None:
            raise ValueError("allow_requests needs a handshake: the registers to write to")
        if self.allow_requests and self.handshake is not None and self.handshake.reached is None:
            raise ValueError(
                "allow_requests needs handshake.reached, the register in which the arm's program says where"
                " it stands; else no answer would ever come"
            )
        if self.handshake is not None:
            self._check_handshake(self.handshake)

    def _check_handshake(self, handshake: HandshakeConfig) -> None:
        if len(handshake.targets) != len(self.joints):
            raise ValueError(
                f"handshake.targets has {len(handshake.targets)} addresses for {len(self.joints)} joints"
            )
        written = sorted(
            [(a, WORDS[j.type]) for a, j in zip(handshake.targets, self.joints, strict=True)]
            + [(handshake.number, 1)]
        )
        if any(a + words > b for (a, words), (b, _) in pairwise(written)):
            raise ValueError("handshake: the registers that are written overlap each other")
        read = [(j.address or 0, WORDS[j.type]) for j in self.joints if j.table == "holding"]
        if any(a < b + n and b < a + m for a, m in written for b, n in read):
            raise ValueError("handshake: a register that is written is also one of the joints'")
