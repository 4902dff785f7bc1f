"""What ``[device.tracker]`` in cell.toml may say with ``driver = "line-stream"``."""

import re
from typing import Literal, Self

from pydantic import Field, model_validator

from cell.laser_tracker import MOST_SIGMA0_M, MOST_SIGMA_PER_M
from drivers.tracker.address import NetAddress, TrackerAddress, parse_address
from drivers.tracker.config import TrackerConfig, TrackerSection

CARTESIAN, POLAR = ("x", "y", "z"), ("hz", "v", "range")
STATED = ("sigma", "u95")
QUATERNION = ("qw", "qx", "qy", "qz")  # of a six-degree target; qw is the scalar
_OTHERS = ("valid", "temperature_c", "pressure_pa", "pressure", "serial")
FIELDS = (*CARTESIAN, *POLAR, *STATED, *QUATERNION, *_OTHERS)
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
_PLAIN: list[Axis] = ["x", "y", "z"]


class StreamReflector(TrackerSection):
    """A reflector whose points arrive in the stream."""

    constant_m: float = Field(
        default=0.0, ge=-0.2, le=0.2, description="Added to the range; 0 when the sender corrects it"
    )


class LineStreamConfig(TrackerConfig):
    """Keys of a device with ``driver = "line-stream"``: a program that sends a point in a line of text."""

    url: str = Field(
        description="tcp://host:port, serial:///dev/ttyUSB1?baudrate=115200&parity=N&stopbits=1, or"
        " udp://host:port: where datagrams are taken, or asked for when there is a request"
    )
    serial: str = Field(
        min_length=1,
        max_length=64,
        description="Of the instrument; a stream does not tell, so it is said here",
    )
    model: str = Field(default="line stream", description="shown as the model of the instrument")
    sigma0_m: float = Field(
        gt=0.0, le=MOST_SIGMA0_M, description="Standard deviation of a reading along one axis, at no range"
    )
    sigma_per_m: float = Field(ge=0.0, le=MOST_SIGMA_PER_M, description="What a metre of range adds to it")
    reflectors: dict[str, StreamReflector] = Field(min_length=1, description="By name, as in { smr1 = {} }")
    pattern: str | None = Field(
        default=None,
        description="Regular expression that a whole line matches, with groups named x, y, z or hz, v, range,"
        " and perhaps valid, temperature_c, pressure_pa or pressure, serial, and qw, qx, qy, qz of a six-"
        'degree target; with driver = "line-points" sigma or u95, too',
    )
    columns: dict[str, int] | None = Field(
        default=None, description="The same names with the number of their column, counted from 1"
    )
    delimiter: str = Field(
        default=",", min_length=1, max_length=4, description="Between columns; ' ': any blanks"
    )
    decimal: Literal[".", ","] = Field(default=".", description="sign before the decimals of a number")
    ignore: str | None = Field(
        default=None, description="Regular expression of whole lines that are passed over, as a heading"
    )
    encoding: Literal["utf-8", "cp1252", "iso-8859-1"] = Field(
        default="utf-8", description="Of the text; cp1252 is what many programs on Windows write"
    )
    pressure_unit: Literal["hPa", "mbar", "mmHg", "inHg"] | None = Field(
        default=None, description="Of a field 'pressure'; pressure_pa is in pascal"
    )
    valid_values: list[str] = Field(default_factory=list, description="What 'valid' says of a good point")
    length_unit: Literal["m", "mm", "in"] = Field(description="Of x, y, z and range")
    angle_unit: Literal["rad", "deg", "gon"] | None = Field(default=None, description="Of hz and v")
    horizontal: Literal["clockwise", "counter-clockwise"] | None = Field(
        default=None,
        description="hz as seen from above: clockwise from y, as stations do, or counter-clockwise from x",
    )
    vertical: Literal["zenith", "elevation"] | None = Field(
        default=None, description="v from straight up, or from the horizon upwards"
    )
    axes: list[Axis] = Field(
        default_factory=lambda: list(_PLAIN),
        min_length=3,
        max_length=3,
        description="Which of the sender's axes become x, y and z of the tracker frame",
    )
    left_handed: bool = Field(
        default=False, description="The sender's frame is left-handed, as northing, easting, height is"
    )
    min_range_m: float = Field(default=0.05, ge=0.0, le=10.0, description="Nearer points are no points")
    max_range_m: float = Field(
        default=200.0, gt=0.0, le=10_000.0, description="readings further away are refused"
    )
    request: str | None = Field(
        default=None, min_length=1, max_length=200, description="Sent for each line, exactly as written"
    )
    poll_period_s: float = Field(default=0.1, ge=0.005, le=10.0, description="Between requests")
    silence_s: float = Field(
        default=2.0,
        ge=0.05,
        le=60.0,
        description="No line for longer, or no answer to a request, ends the link",
    )
    stamp_uncertainty_s: float = Field(
        default=0.01, ge=0.0, le=1.0, description="Half-width of the stamps' uncertainty, without a request"
    )
    broken_after_s: float = Field(
        default=1.0, gt=0.0, le=30.0, description="No valid point for longer is a broken beam"
    )
    lost_after_bad: int = Field(
        default=20, ge=1, le=10_000, description="Lines in a row that cannot be read that end the link"
    )
    find_radius_m: float = Field(
        default=0.1, gt=0.0, le=5.0, description="A reflector is where it is expected within this distance"
    )
    only_from: str | None = Field(default=None, description="Address whose datagrams are taken; absent: any")

    @property
    def address(self) -> TrackerAddress:
        """Where the lines come from."""
        return parse_address(self.url, udp=True)

    @property
    def listens(self) -> bool:
        """Whether datagrams come to us unasked."""
        address = self.address
        return isinstance(address, NetAddress) and address.scheme == "udp" and self.request is None

    @property
    def fields(self) -> frozenset[str]:
        """The names that a line gives."""
        if self.pattern is not None:
            return frozenset(re.compile(self.pattern).groupindex)
        return frozenset(self.columns or ())

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        parse_address(self.url, udp=True)
        if self.only_from is not None and not self.listens:
            raise ValueError("only_from is for a udp:// url without a request")
        if (self.pattern is None) == (self.columns is None):
            raise ValueError("either pattern or columns is needed, and not both")
        for key in ("pattern", "ignore"):
            _compile(key, getattr(self, key))
        if self.columns is not None and min(self.columns.values(), default=1) < 1:
            raise ValueError("columns are counted from 1")
        if self.request is not None and self.poll_period_s >= self.broken_after_s:
            raise ValueError("broken_after_s has to be longer than poll_period_s")
        self._check_fields()
        return self

    def _check_fields(self) -> None:
        fields = self.fields
        if unknown := sorted(fields - set(FIELDS)):
            raise ValueError(f"a line has no '{unknown[0]}'; there is {', '.join(FIELDS)}")
        polar, cartesian = fields >= set(POLAR), fields >= set(CARTESIAN)
        if polar == cartesian or (fields & set(POLAR) and fields & set(CARTESIAN)):
            raise ValueError("a line has to give x, y and z, or hz, v and range, and none of the other three")
        for key in ("angle_unit", "horizontal", "vertical"):
            if (getattr(self, key) is None) == polar:
                raise ValueError(f"{key} is {'needed' if polar else 'only'} for hz, v and range")
        if ("valid" in fields) != bool(self.valid_values):
            raise ValueError("valid_values and a field 'valid' are needed together")
        if ("pressure" in fields) != (self.pressure_unit is not None):
            raise ValueError("pressure_unit and a field 'pressure' are needed together")
        if {"pressure", "pressure_pa"} <= fields:
            raise ValueError("a line gives pressure or pressure_pa, not both")
        self._check_stated(fields)
        if 0 < len(turned := fields & set(QUATERNION)) < len(QUATERNION):
            raise ValueError(f"'{min(turned)}' is of a rotation: give qw, qx, qy and qz, or none of them")
        if turned and self.left_handed:
            raise ValueError("qw, qx, qy and qz have no meaning in a left_handed frame; take them out")
        if polar and (self.left_handed or self.axes != _PLAIN):
            raise ValueError(
                "axes and left_handed are for x, y, z; horizontal and vertical say it for angles"
            )
        self._check_axes()

    def _check_stated(self, fields: frozenset[str]) -> None:
        if stated := sorted(fields & set(STATED)):
            raise ValueError(f"'{stated[0]}' is of a point that is asked for, with driver = \"line-points\"")

    def _check_axes(self) -> None:
        names = [a.removeprefix("-") for a in self.axes]
        if sorted(names) != ["x", "y", "z"]:
            raise ValueError(f"axes {self.axes} should name each of x, y and z once")
        mirrored = (_is_odd(names) + sum(a.startswith("-") for a in self.axes)) % 2 == 1
        if mirrored != self.left_handed:
            means = "mirrors" if mirrored else "does not mirror"
            raise ValueError(
                f"axes = {self.axes} {means} the sender's frame, but left_handed ="
                f" {str(self.left_handed).lower()}; the tracker frame must be right-handed"
            )


def _compile(key: str, expression: str | None) -> None:
    try:
        re.compile(expression or "")
    except re.error as exc:
        raise ValueError(f"{key} is no regular expression: {exc}") from exc


def _is_odd(names: list[str]) -> bool:
    order = ["xyz".index(n) for n in names]
    return sum(order[i] > order[j] for i in range(3) for j in range(i + 1, 3)) % 2 == 1
