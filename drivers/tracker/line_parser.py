"""One line of text as a point in the tracker frame."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cell.poses import Array
from drivers.tracker.frames import from_mathematical, from_station
from drivers.tracker.line_config import CARTESIAN, QUATERNION, STATED, LineStreamConfig

_METRES = {"m": 1.0, "mm": 1e-3, "in": 0.0254}
_PASCALS = {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "mmHg": 133.322, "inHg": 3386.389}
_LEAST_PA, _MOST_PA = 40_000.0, 115_000.0  # above the highest settlements, and below the Dead Sea
_UNIT = 1e-3  # by which a quaternion may be longer or shorter than 1: some are written with few digits
_RADIANS = {"rad": 1.0, "deg": math.pi / 180, "gon": math.pi / 200}


class BadLine(ValueError):
    """A line that cannot be read, with the reason."""


@dataclass(frozen=True)
class Parsed:
    """What a line says; ``point`` (3,) is None with ``status`` when the sender has none."""

    point: Array | None
    status: str
    temperature_c: float | None = None
    pressure_pa: float | None = None
    sigma_m: float | None = None  # along one axis, as the sender states it of this very point
    rotation: Array | None = None  # (3,) rotation vector of a six-degree target, rad


class LineParser:
    """Reads what the config describes and guesses nothing."""

    def __init__(self, config: LineStreamConfig) -> None:
        self._config = config
        self._pattern = re.compile(config.pattern) if config.pattern is not None else None
        self._ignore = re.compile(config.ignore) if config.ignore is not None else None
        self._polar = "range" in config.fields
        self._axes = [("xyz".index(a[-1]), -1.0 if a.startswith("-") else 1.0) for a in config.axes]

    def parse(self, line: bytes, constant_m: float = 0.0) -> Parsed | None:
        """None for a line to pass over, else what it says; :class:`BadLine`.

        ``constant_m`` is added to the range of the point.
        """
        encoding = self._config.encoding
        text = line.decode(encoding, "replace").strip()
        if self._ignore is not None and self._ignore.fullmatch(text):
            return None
        if "\N{REPLACEMENT CHARACTER}" in text:
            raise BadLine(f"it is not text in {encoding}; encoding says what it is in")
        found = self._fields(text)
        config = self._config
        if (serial := found.get("serial")) is not None and serial.strip() != config.serial:
            raise BadLine(f"it is from {serial.strip()}, not from {config.serial}")
        air = (
            self._number(found, "temperature_c") if "temperature_c" in found else None,
            self._pressure(found),
        )
        if (valid := found.get("valid")) is not None and valid.strip() not in config.valid_values:
            return Parsed(None, f"the sender says '{valid.strip()}'", *air)
        point = self._point(found)
        distance = math.hypot(*point)
        if not config.min_range_m <= distance <= config.max_range_m:
            return Parsed(None, f"a point at {distance:g} m is no point", *air)
        return Parsed(
            point * (1.0 + constant_m / distance), "", *air, self._sigma(found), self._rotation(found)
        )

    def _fields(self, text: str) -> Mapping[str, str]:
        if self._pattern is not None:
            match = self._pattern.fullmatch(text)
            if match is None:
                raise BadLine("it does not match the pattern")
            return {name: value for name, value in match.groupdict().items() if value is not None}
        delimiter = self._config.delimiter
        cells = text.split() if delimiter == " " else text.split(delimiter)  # blanks line numbers up
        columns = self._config.columns or {}
        if (most := max(columns.values())) > len(cells):
            raise BadLine(f"it has {len(cells)} columns, and {most} are needed")
        return {name: cells[number - 1] for name, number in columns.items()}

    def _point(self, found: Mapping[str, str]) -> Array:
        metre = _METRES[self._config.length_unit]
        if not self._polar:
            own = [metre * self._number(found, name) for name in CARTESIAN]
            return np.array([sign * own[index] for index, sign in self._axes])
        radian = _RADIANS[self._config.angle_unit or "rad"]
        hz, v = radian * self._number(found, "hz"), radian * self._number(found, "v")
        distance = metre * self._number(found, "range")
        if self._config.horizontal == "clockwise":
            return from_station(hz, v if self._config.vertical == "zenith" else math.pi / 2 - v, distance)
        return from_mathematical(hz, v if self._config.vertical == "elevation" else math.pi / 2 - v, distance)

    def _rotation(self, found: Mapping[str, str]) -> Array | None:
        """Of the target, by the unit quaternion that a line gives; in the axes of the point's coordinates.

        None where the four are blank or zero: the sender saw the point alone.
        """
        if "qw" not in found or not any(found[name].strip() for name in QUATERNION):
            return None
        quaternion = [self._number(found, name) for name in QUATERNION]
        if not any(quaternion):
            return None
        if abs(math.hypot(*quaternion) - 1.0) > _UNIT:
            raise BadLine(f"its rotation is no unit quaternion, but {math.hypot(*quaternion):.4g} long")
        to_tracker = np.zeros((3, 3))
        for row, (index, sign) in enumerate(self._axes):
            to_tracker[row, index] = sign
        turned = Rotation.from_matrix(to_tracker) * Rotation.from_quat(quaternion, scalar_first=True)
        return np.asarray(turned.as_rotvec())

    def _sigma(self, found: Mapping[str, str]) -> float | None:
        """Half of an uncertainty of 95 %, where that is what the sender states."""
        name = next((name for name in STATED if name in found), None)
        if name is None:
            return None
        stated = (
            self._number(found, name) * _METRES[self._config.length_unit] / (2.0 if name == "u95" else 1.0)
        )
        if stated < 0.0:
            raise BadLine(f"its {name} is negative")
        return stated

    def _pressure(self, found: Mapping[str, str]) -> float | None:
        """Of the air, Pa. One in another unit would be a wrong correction of every distance."""
        name = "pressure" if "pressure" in found else "pressure_pa"
        if name not in found:
            return None
        value = self._number(found, name) * _PASCALS[self._config.pressure_unit or "Pa"]
        if not _LEAST_PA <= value <= _MOST_PA:
            raise BadLine(
                f"its {name} of {value:g} Pa is no pressure of air; where it has another unit, name the "
                "field 'pressure' and give pressure_unit in cell.toml"
            )
        return value

    def _number(self, found: Mapping[str, str], name: str) -> float:
        text = found.get(name, "").strip()
        plain = text.replace(",", ".") if self._config.decimal == "," else text
        try:
            value = float(plain)
        except ValueError as exc:
            raise BadLine(f"its {name} is '{text[:20]}', which is no number") from exc
        if not math.isfinite(value) or "_" in plain:
            raise BadLine(f"its {name} is '{text[:20]}', which is no number")
        return value
