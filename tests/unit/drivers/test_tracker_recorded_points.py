"""Readings of a real laser tracker, in lines of the form that its program exports.

The figures are two readings of a six-degree target in the calibration set of T. Zhang and
others: HUST_NC_Robot, Mendeley Data, V1 (2023), doi 10.17632/srxktn4752.1. So is the order of the
columns; the lines are put together here.
"""

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.tracker.line_config import LineStreamConfig
from drivers.tracker.line_parser import BadLine, LineParser
from drivers.tracker.line_points import LinePointConfig
from tests.unit.drivers.test_tracker_config import STREAM

Reading = tuple[tuple[float, ...], float, tuple[float, ...]]

# X, Y, Z and U(95) in mm; the quaternion, scalar first
READINGS: list[Reading] = [
    ((754.0, -3193.366, 303.745), 0.004, (0.227782, -0.114534, 0.572354, 0.779364)),
    ((394.456, -3200.746, -664.155), 0.01, (0.388994, -0.204948, -0.801604, -0.405106)),
]
COLUMNS = {"x": 1, "y": 2, "z": 3, "qw": 9, "qx": 10, "qy": 11, "qz": 12, "temperature_c": 15}
FORM: dict[str, Any] = {
    **STREAM,
    "columns": {**COLUMNS, "pressure": 16},
    "encoding": "cp1252",
    "pressure_unit": "mbar",
    "ignore": "X .*",
}
HEADING = "X [mm],Y [mm],Z [mm],Image RMS [\N{MICRO SIGN}m],Temperature [\N{DEGREE SIGN}C]"


def line_of(point: tuple[float, ...], u95: float, quaternion: tuple[float, ...]) -> bytes:
    """X, Y, Z; U(95), also by axis; tilt; Q0 to Q3; image RMS; target; temperature; pressure; humidity."""
    cells = (*point, u95, 0.003, 0.001, 0.003, 29.9, *quaternion, 0.22, "target", 22.8, 1018, 32)
    return ",".join(map(str, cells)).encode("cp1252")


def test_points_rotations_and_air_are_those_that_the_instrument_measured() -> None:
    subject = LineParser(LineStreamConfig(**FORM))
    assert subject.parse(HEADING.encode("cp1252")) is None
    for point, u95, quaternion in READINGS:
        parsed = subject.parse(line_of(point, u95, quaternion))
        assert parsed is not None
        assert parsed.point == pytest.approx(np.array(point) * 1e-3)
        assert parsed.rotation is not None
        assert np.linalg.norm(parsed.rotation) == pytest.approx(2.0 * math.acos(quaternion[0]), abs=1e-5)
        expected = Rotation.from_quat([*quaternion[1:], quaternion[0]]).as_matrix()
        assert Rotation.from_rotvec(parsed.rotation).as_matrix() == pytest.approx(expected)
        assert (parsed.temperature_c, parsed.pressure_pa) == (22.8, 101800.0)


def test_half_of_its_95_percent_is_the_standard_deviation_of_a_point_that_was_asked_for() -> None:
    columns = {**FORM["columns"], "u95": 4}
    config = LinePointConfig(**{**FORM, "columns": columns, "request": "M\n"})
    parsed = LineParser(config).parse(line_of(*READINGS[1]))
    assert parsed is not None
    assert parsed.sigma_m == pytest.approx(5e-6)


def test_its_millibars_are_no_pascals() -> None:
    columns = {**COLUMNS, "pressure_pa": 16}
    subject = LineParser(LineStreamConfig(**{**FORM, "columns": columns, "pressure_unit": None}))
    with pytest.raises(BadLine, match="1018 Pa is no pressure of air"):
        subject.parse(line_of(*READINGS[0]))
