"""What the device sections of trackers refuse, and where they find the instrument."""

from typing import Any

import pytest
from pydantic import ValidationError

from drivers.serial_url import SerialLine
from drivers.tracker import GeocomConfig, LineStreamConfig
from drivers.tracker.address import NetAddress, parse_address

GEOCOM: dict[str, Any] = {"url": "tcp://127.0.41.1:1212", "reflectors": {"smr1": {"constant_m": 0.0}}}
STREAM: dict[str, Any] = {
    "url": "tcp://127.0.41.1:1213",
    "serial": "99994400001",
    "sigma0_m": 15e-6,
    "sigma_per_m": 6e-6,
    "reflectors": {"smr1": {}},
    "columns": {"x": 1, "y": 2, "z": 3},
    "length_unit": "mm",
}
POLAR: dict[str, Any] = {
    "columns": {"hz": 1, "v": 2, "range": 3},
    "angle_unit": "gon",
    "horizontal": "clockwise",
    "vertical": "zenith",
}


@pytest.mark.parametrize(
    ("url", "place"),
    [
        ("tcp://10.0.0.7:1212", NetAddress("tcp", "10.0.0.7", 1212)),
        ("udp://0.0.0.0:5555", NetAddress("udp", "0.0.0.0", 5555)),
        ("serial:///dev/ttyUSB1?baudrate=57600&parity=E", SerialLine("/dev/ttyUSB1", 57600, "E")),
    ],
)
def test_a_url_says_where_the_instrument_is(url: str, place: NetAddress | SerialLine) -> None:
    assert parse_address(url, udp=True) == place


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("tcp://10.0.0.7", "needs a port"),
        ("tcp://10.0.0.7:0", "needs a port"),
        ("tcp://10.0.0.7:99999", "needs a port"),
        ("udp://0.0.0.0:5555", "begin with tcp:// or serial://"),
        ("serial://dev/ttyUSB1", "three slashes"),
        ("serial:///dev/ttyUSB1?speed=9600", "unknown setting 'speed'"),
        ("10.0.0.7:1212", "begin with tcp:// or serial://"),
    ],
)
def test_a_url_that_says_no_place_is_refused_with_the_fix(url: str, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        GeocomConfig(**{**GEOCOM, "url": url})


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"reflectors": {}}, "reflectors"),
        ({"reflectors": {"smr1": {}}}, "constant_m"),
        ({"measure_with": "tracking", "tracking": "off"}, "needs tracking"),
        ({"measure_with": "tracking", "reading": "simple"}, "tell a new distance"),
        ({"temperature_c": 20.0}, "needed together"),
        ({"sigma0": 1.0}, "sigma0"),
    ],
)
def test_a_station_that_does_not_fit_together_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        GeocomConfig(**{**GEOCOM, **keys})


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"columns": None}, "either pattern or columns"),
        ({"pattern": "(?P<x>.)"}, "either pattern or columns"),
        ({"columns": {"x": 1, "y": 2}}, "x, y and z, or hz, v and range"),
        ({"columns": {"x": 1, "y": 2, "z": 3, "range": 4}}, "none of the other three"),
        ({"columns": {"x": 0, "y": 1, "z": 2}}, "counted from 1"),
        ({"columns": {"x": 1, "y": 2, "z": 3, "height": 4}}, "no 'height'"),
        ({"columns": None, "pattern": "("}, "no regular expression"),
        ({"ignore": "["}, "no regular expression"),
        ({"columns": {"x": 1, "y": 2, "z": 3, "valid": 4}}, "valid_values"),
        ({"valid_values": ["1"]}, "valid_values"),
        ({"columns": POLAR["columns"]}, "angle_unit is needed"),
        ({"angle_unit": "deg"}, "angle_unit is only"),
        ({**POLAR, "vertical": None}, "vertical is needed"),
        ({**POLAR, "left_handed": True}, "axes and left_handed are for x, y, z"),
        ({"axes": ["x", "y", "y"]}, "each of x, y and z once"),
        ({"axes": ["y", "x", "z"]}, "mirrors the sender's frame"),
        ({"axes": ["x", "y", "-z"]}, "mirrors the sender's frame"),
        ({"left_handed": True}, "does not mirror"),
        ({"length_unit": "ft"}, "length_unit"),
        ({"only_from": "10.0.0.7"}, "only_from"),
        ({"request": "GET", "poll_period_s": 1.5}, "longer than poll_period_s"),
    ],
)
def test_a_stream_that_does_not_fit_together_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        LineStreamConfig(**{**STREAM, **keys})


@pytest.mark.parametrize("key", ["serial", "sigma0_m", "sigma_per_m", "length_unit"])
def test_what_a_stream_cannot_tell_has_to_be_said(key: str) -> None:
    with pytest.raises(ValidationError, match=key):
        LineStreamConfig(**{k: v for k, v in STREAM.items() if k != key})


@pytest.mark.parametrize(
    "keys",
    [
        {"axes": ["y", "x", "z"], "left_handed": True},
        {"axes": ["y", "-x", "z"]},
        {"axes": ["z", "x", "y"]},
        {"axes": ["-x", "-y", "z"]},
        POLAR,
        {"url": "udp://127.0.41.1:5", "only_from": "127.0.41.2"},
    ],
)
def test_a_stream_that_fits_together_is_taken(keys: dict[str, Any]) -> None:
    assert LineStreamConfig(**{**STREAM, **keys}).fields
