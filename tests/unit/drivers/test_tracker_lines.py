"""Lines of text as points in the tracker frame, and the frame itself."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from drivers.tracker import LineStreamConfig
from drivers.tracker.frames import from_mathematical, from_station, to_station
from drivers.tracker.line_parser import BadLine, LineParser
from drivers.tracker.stable import StableWindow
from drivers.tracker.wire import Lines
from tests.unit.drivers.test_tracker_config import POLAR, STREAM

COORDINATE = st.floats(-50.0, 50.0).filter(lambda x: abs(x) > 0.01)


def parser(**keys: Any) -> LineParser:
    return LineParser(LineStreamConfig(**{**STREAM, **keys}))


def point(line: bytes, constant_m: float = 0.0, **keys: Any) -> list[float]:
    parsed = parser(**keys).parse(line, constant_m)
    assert parsed is not None
    assert parsed.point is not None
    return list(parsed.point)


@pytest.mark.parametrize(
    ("hz", "v", "expected"),
    [
        (0.0, math.pi / 2, [0, 2, 0]),
        (math.pi / 2, math.pi / 2, [2, 0, 0]),
        (1.0, 0.0, [0, 0, 2]),
        (3 * math.pi / 2, math.pi / 2, [-2, 0, 0]),
    ],
)
def test_a_station_reads_clockwise_from_y_and_down_from_z(hz: float, v: float, expected: list[float]) -> None:
    np.testing.assert_allclose(from_station(hz, v, 2.0), expected, atol=1e-15)


@given(COORDINATE, COORDINATE, COORDINATE)
def test_pointing_is_the_inverse_of_reading(x: float, y: float, z: float) -> None:
    hz, v, slope = to_station(np.array([x, y, z]))
    assert 0 <= hz < 2 * math.pi
    np.testing.assert_allclose(from_station(hz, v, slope), [x, y, z], atol=1e-12)


@given(st.floats(0.0, 6.0), st.floats(-1.5, 1.5), st.floats(0.1, 50.0))
def test_the_frame_is_right_handed(azimuth: float, elevation: float, distance: float) -> None:
    """A turn about z by scipy's right-handed convention adds to the mathematical azimuth."""
    turned = Rotation.from_euler("z", 0.1).apply(from_mathematical(azimuth, elevation, distance))
    np.testing.assert_allclose(turned, from_mathematical(azimuth + 0.1, elevation, distance), atol=1e-12)
    clockwise = from_station(math.pi / 2 - azimuth, math.pi / 2 - elevation, distance)
    np.testing.assert_allclose(clockwise, from_mathematical(azimuth, elevation, distance), atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("m", [1.0, -2.0, 3.0]), ("mm", [0.001, -0.002, 0.003]), ("in", [0.0254, -0.0508, 0.0762])],
)
def test_lengths_become_metres(unit: str, metres: list[float]) -> None:
    assert point(b"1,-2,3", length_unit=unit, min_range_m=0.0) == pytest.approx(metres)


def test_a_pattern_finds_the_fields_by_name() -> None:
    pattern = r"PT \d+ X=(?P<x>\S+) Y=(?P<y>\S+) Z=(?P<z>\S+) T=(?P<temperature_c>\S+)"
    parsed = parser(pattern=pattern, columns=None).parse(b" PT 7 X=1000.5 Y=2e3 Z=-3000 T=20.5\r")
    assert parsed is not None
    np.testing.assert_allclose(parsed.point, [1.0005, 2.0, -3.0])
    assert (parsed.temperature_c, parsed.pressure_pa) == (20.5, None)


def test_columns_with_a_decimal_comma_are_read() -> None:
    columns = {"x": 2, "y": 3, "z": 5}
    assert point(b"7;1000,5;2000;OK;-3000", delimiter=";", decimal=",", columns=columns) == pytest.approx(
        [1.0005, 2.0, -3.0]
    )


def test_white_space_separates_columns_however_much_there_is() -> None:
    assert point(b"1000   2000\t3000", delimiter=" ") == pytest.approx([1, 2, 3])


@pytest.mark.parametrize(
    ("keys", "line", "expected"),
    [
        ({}, b"100,100,2000", [2, 0, 0]),
        ({"angle_unit": "deg"}, b"90,90,2000", [2, 0, 0]),
        ({"angle_unit": "rad"}, b"0,1.5707963267948966,2000", [0, 2, 0]),
        ({"vertical": "elevation"}, b"0,100,2000", [0, 0, 2]),
        ({"horizontal": "counter-clockwise"}, b"100,100,2000", [0, 2, 0]),
        ({"horizontal": "counter-clockwise", "vertical": "elevation"}, b"0,-100,2000", [0, 0, -2]),
    ],
)
def test_angles_are_read_in_their_unit_and_sense(
    keys: dict[str, Any], line: bytes, expected: list[float]
) -> None:
    np.testing.assert_allclose(point(line, **{**POLAR, **keys}), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("axes", "left_handed", "expected"),
    [
        (["x", "y", "z"], False, [1, 2, 3]),
        (["y", "x", "z"], True, [2, 1, 3]),
        (["y", "-x", "z"], False, [2, -1, 3]),
        (["z", "x", "y"], False, [3, 1, 2]),
    ],
)
def test_the_senders_axes_become_ours(axes: list[str], left_handed: bool, expected: list[float]) -> None:
    assert point(b"1000,2000,3000", axes=axes, left_handed=left_handed) == expected


def test_a_constant_is_added_along_the_line_of_sight() -> None:
    assert point(b"0,3000,4000", constant_m=0.5) == pytest.approx([0, 3.3, 4.4])


def test_a_point_that_the_sender_calls_invalid_is_none_with_its_words() -> None:
    subject = parser(columns={"x": 1, "y": 2, "z": 3, "valid": 4}, valid_values=["OK", "1"])
    good, bad = subject.parse(b"1000,0,0, OK"), subject.parse(b"1000,0,0,LOST")
    assert good is not None
    assert good.point is not None
    assert bad is not None
    assert (bad.point, bad.status) == (None, "the sender says 'LOST'")


def test_a_point_at_the_instrument_itself_is_no_point() -> None:
    parsed = parser().parse(b"0,0,0")
    assert parsed is not None
    assert (parsed.point, parsed.status) == (None, "a point at 0 m is no point")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"", "1 columns, and 3 are needed"),
        (b"1,2", "2 columns, and 3 are needed"),
        (b"1,2,nan", "its z is 'nan', which is no number"),
        (b"1,2,1e999", "which is no number"),
        (b"1,2,3_000", "which is no number"),
        (b"1,,3", "its y is '', which is no number"),
        (b"1,\xff,3", "not text"),
    ],
)
def test_a_line_that_cannot_be_read_says_why(line: bytes, words: str) -> None:
    with pytest.raises(BadLine, match=words):
        parser().parse(line)


SIX = {"columns": {name: k for k, name in enumerate(("x", "y", "z", "qw", "qx", "qy", "qz"), 1)}}


def test_the_rotation_of_a_six_degree_target_is_turned_with_its_point() -> None:
    sent = Rotation.from_rotvec([0.3, -0.4, 1.2])
    line = ",".join(map(str, (1000, 2000, 500, *sent.as_quat(scalar_first=True)))).encode()
    plain = parser(**SIX).parse(line)
    assert plain is not None
    assert plain.rotation == pytest.approx([0.3, -0.4, 1.2])
    turned = parser(**SIX, axes=["y", "-x", "z"]).parse(line)
    assert turned is not None
    assert turned.point is not None
    assert turned.rotation is not None
    assert turned.point == pytest.approx([2.0, -1.0, 0.5])
    # What the target carries along its own x, 0.1 m away, has to be at the same place by either frame.
    ahead = np.array([1.0, 2.0, 0.5]) + 0.1 * sent.apply([1.0, 0.0, 0.0])
    found = turned.point + Rotation.from_rotvec(turned.rotation).apply([0.1, 0.0, 0.0])
    assert found == pytest.approx([ahead[1], -ahead[0], ahead[2]])


@pytest.mark.parametrize("rotation", ["0,0,0,0", ",,,"])
def test_a_line_of_the_point_alone_keeps_its_point(rotation: str) -> None:
    found = parser(**SIX).parse(f"1000,2000,500,{rotation}".encode())
    assert found is not None
    assert found.point == pytest.approx([1.0, 2.0, 0.5])
    assert found.rotation is None


def test_a_rotation_that_is_none_is_refused() -> None:
    with pytest.raises(BadLine, match="no unit quaternion, but 2 long"):
        parser(**SIX).parse(b"1000,2000,500,2,0,0,0")
    with pytest.raises(ValidationError, match="'qw' is of a rotation"):
        parser(columns={"x": 1, "y": 2, "z": 3, "qw": 4})
    with pytest.raises(ValidationError, match="left_handed frame"):
        parser(**SIX, left_handed=True, axes=["y", "x", "z"])


def test_a_stable_point_has_the_mean_of_its_rotations() -> None:
    subject = StableWindow(0.1, 1e-3, 2)
    for k, z in enumerate((0.1, 0.3)):
        subject.add(float(k), 0.01, np.array([1.0, 0.0, 0.0]), rotation=np.array([0.0, 0.0, z]))
    assert subject.sample(1, None, None).value.rotation == pytest.approx([0.0, 0.0, 0.2])
    subject.add(2.0, 0.01, np.array([1.0, 0.0, 0.0]))
    assert subject.sample(1, None, None).value.rotation is None


def test_a_line_of_another_instrument_is_refused() -> None:
    subject = parser(columns={"x": 1, "y": 2, "z": 3, "serial": 4})
    assert subject.parse(b"1000,0,0,99994400001") is not None
    with pytest.raises(BadLine, match="from 4711, not from 99994400001"):
        subject.parse(b"1000,0,0,4711")


@pytest.mark.parametrize("huge", [b"1e300,1e300,1e300", b"1e308,-1e308,0"])
def test_a_point_beyond_all_reach_is_no_point(huge: bytes) -> None:
    parsed = parser().parse(huge)
    assert parsed is not None
    assert parsed.point is None


def test_headings_are_passed_over() -> None:
    assert parser(ignore="#.*").parse(b"# x, y, z") is None


@given(st.binary(max_size=200))
def test_no_bytes_whatever_do_more_than_be_refused(line: bytes) -> None:
    try:
        parsed = parser().parse(line)
    except BadLine:
        return
    assert parsed is not None
    assert parsed.point is None or np.all(np.isfinite(parsed.point))


@given(
    st.lists(st.binary(min_size=1, max_size=30).filter(lambda b: not set(b) & {10, 13} and b.strip())),
    st.data(),
)
def test_lines_come_out_whole_however_they_are_cut(lines: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(line + b"\r\n" for line in lines)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    subject, found = Lines(), []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += subject.feed(stream[begin:end])
    assert found == lines


def test_a_line_that_never_ends_is_dropped_whole() -> None:
    subject = Lines(longest=100)
    assert subject.feed(b"good\n" + b"x" * 80) == [b"good"]
    assert subject.feed(b"x" * 80) == []
    assert subject.feed(b"xx\nnext\n") == [b"next"]
    assert subject.dropped == 1


def test_a_window_is_full_with_its_time_and_its_readings() -> None:
    subject = StableWindow(1.0, 1e-3, 3)
    at = np.zeros(3)
    assert [subject.add(t, 0.0, at) for t in (0.0, 0.1, 0.5, 0.99)] == [False] * 4
    assert subject.add(1.0, 0.0, at)
    sample = subject.sample(5, 20.0, None)
    assert (sample.t, sample.dt, sample.value.count, sample.value.window_s) == (0.5, 0.5, 5, 1.0)


def test_a_window_slides_until_the_readings_agree() -> None:
    subject = StableWindow(0.0, 1e-3, 3)
    moving = [0.00, 0.01, 0.02, 0.03, 0.03]
    assert not any(subject.add(t, 0.0, np.array([x, 0.0, 0.0])) for t, x in enumerate(moving))
    assert subject.add(5.0, 0.0, np.array([0.03, 0.0, 0.0]))
    sample = subject.sample(1, None, None)
    assert sample.value.count == 3
    np.testing.assert_allclose(sample.value.point, [0.03, 0, 0], atol=1e-15)


def test_the_scatter_is_the_rms_distance_from_the_mean() -> None:
    points = np.random.default_rng(3).normal(scale=1e-5, size=(50, 3))
    subject = StableWindow(4.9, 1.0, 50)
    for k, p in enumerate(points):
        subject.add(0.1 * k, 0.0, p)
    found = subject.sample(1, None, None).value
    assert found.count == 50
    assert found.scatter_m == pytest.approx(math.sqrt(np.var(points, axis=0).sum()), rel=1e-12)


def test_a_hole_in_the_readings_begins_the_window_anew() -> None:
    subject = StableWindow(0.0, 1e-3, 3)
    subject.add(0.0, 0.0, np.zeros(3))
    subject.add(1.0, 0.0, np.zeros(3))
    subject.restart()
    assert not subject.add(2.0, 0.0, np.zeros(3))


def test_only_warnings_of_readings_that_count_are_told() -> None:
    subject = StableWindow(0.0, 1e-3, 2)
    subject.add(0.0, 0.0, np.ones(3), "1284")
    subject.add(1.0, 0.0, np.zeros(3), "1283")
    assert subject.add(2.0, 0.0, np.zeros(3), "1283")
    assert subject.sample(1, None, None).value.warnings == ("1283",)


def test_text_of_windows_programs_is_read_in_its_encoding() -> None:
    line = "1000,0,0,20.5 °C µm".encode("cp1252")
    assert point(line, encoding="cp1252") == pytest.approx([1.0, 0.0, 0.0])
    with pytest.raises(BadLine, match="not text in utf-8; encoding says"):
        parser().parse(line)


def test_a_heading_in_another_encoding_is_passed_over_all_the_same() -> None:
    assert parser(ignore="X.*").parse("X [mm], T [°C], U95 [µm]".encode("cp1252")) is None


@pytest.mark.parametrize(
    ("field", "unit", "text", "pascal"),
    [
        ("pressure_pa", None, b"101325", 101325.0),
        ("pressure", "mbar", b"1018", 101800.0),
        ("pressure", "mmHg", b"760", 101325.0),
        ("pressure", "inHg", b"29.92", 101321.0),
    ],
)
def test_the_pressure_of_the_air_has_a_unit(field: str, unit: str | None, text: bytes, pascal: float) -> None:
    keys = {} if unit is None else {"pressure_unit": unit}
    parsed = parser(columns={"x": 1, "y": 2, "z": 3, field: 4}, **keys).parse(b"1000,0,0," + text)
    assert parsed is not None
    assert parsed.pressure_pa == pytest.approx(pascal, abs=10.0)


def test_millibars_are_not_taken_for_pascals() -> None:
    with pytest.raises(BadLine, match=r"pressure_pa of 1018 Pa is no pressure of air; .* give pressure_unit"):
        parser(columns={"x": 1, "y": 2, "z": 3, "pressure_pa": 4}).parse(b"1000,0,0,1018")


@pytest.mark.parametrize(
    ("columns", "unit", "words"),
    [
        ({"pressure": 4}, None, "pressure_unit and a field 'pressure' are needed together"),
        ({}, "mbar", "pressure_unit and a field 'pressure' are needed together"),
        ({"pressure": 4, "pressure_pa": 5}, "mbar", "not both"),
    ],
)
def test_a_pressure_without_its_unit_is_no_configuration(
    columns: dict[str, int], unit: str | None, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        parser(columns={"x": 1, "y": 2, "z": 3, **columns}, pressure_unit=unit)


def test_what_a_sender_states_of_its_point_is_for_points_that_are_asked_for() -> None:
    with pytest.raises(
        ValidationError, match=r"'u95' is of a point that is asked for, with driver = .line-points"
    ):
        parser(columns={"x": 1, "y": 2, "z": 3, "u95": 4})
