"""GeoCOM's lines and return codes, against byte strings from manuals and against geocompy."""

import pytest
from geocompy.communication import crc16_bytewise
from geocompy.geo import GeoCom
from geocompy.geo.gctypes import GeoComCode
from hypothesis import given
from hypothesis import strategies as st

from cell.errors import catalogue
from drivers.tracker.geocom_codes import CODES, Meaning, return_code
from drivers.tracker.geocom_text import Reply, Unreadable, crc16, parse_reply, request

VALUES = st.one_of(
    st.booleans(),
    st.integers(-(2**31), 2**31 - 1),
    st.floats(-1e6, 1e6),
    st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='"'), max_size=12),
)


class Scripted(GeoCom):
    """geocompy's own reader and writer of lines, without a connection."""

    def __init__(self, checksum: bool) -> None:
        self._checksum, self._precision, self.transaction_counter = checksum, 15, 7
        self._conn = self  # type: ignore[assignment]
        self._logger = __import__("logging").getLogger("geocompy.dummy")
        self.sent = ""

    def exchange(self, command: str) -> str:
        self.sent = command
        return "%R1P,0,7:0"


def test_the_check_sum_is_the_published_crc_16_arc() -> None:
    assert crc16(b"123456789") == 0xBB3D


@given(st.binary(max_size=100))
def test_the_check_sum_is_that_of_geocompy(data: bytes) -> None:
    assert crc16(data) == crc16_bytewise(data)


@pytest.mark.parametrize(
    ("expected", "rpc", "parameters"),
    [
        (b"%R1Q,0,7:\r\n", 0, ()),
        (b"%R1Q,2008,7:1,1\r\n", 2008, (1, 1)),
        (b"%R1Q,9027,7:1.5,0.0000001,0,0,0\r\n", 9027, (1.5, 1e-7, 0, 0, False)),
        (b"%R1Q,2024,7:-0.0344\r\n", 2024, (-0.0344,)),
        (b"%R1Q,2024,7:0.0\r\n", 2024, (-0.0,)),
        (b'%R1Q,17030,7:9,"smr"\r\n', 17030, (9, "smr")),
    ],
)
def test_a_request_is_written_as_the_manual_shows_it(expected: bytes, rpc: int, parameters: tuple) -> None:
    assert request(rpc, 7, *parameters) == expected


@given(st.integers(0, 30000), st.lists(VALUES, max_size=6), st.booleans())
def test_a_request_reads_as_geocompy_would_write_it(rpc: int, values: list, checksum: bool) -> None:
    ours = request(rpc, 7, *values, checksum=checksum)
    geocompy = Scripted(checksum)
    # Its numbers have 6 decimals and no more, so both are asked to write those that have no more.
    rounded = [round(v, 3) + 0.0 if type(v) is float else v for v in values]
    geocompy.request(rpc, rounded)
    assert request(rpc, 7, *rounded, checksum=checksum) == geocompy.sent.encode() + b"\r\n"
    head, _, tail = ours[:-2].partition(b":")
    assert (head.count(b",") == 3) is checksum
    read = parse_reply(b"%R1P,0,7:0," + tail).values if values else ()
    assert [float(r) for r, v in zip(read, values, strict=True) if not isinstance(v, str)] == pytest.approx(
        [float(v) for v in values if not isinstance(v, str)], rel=1e-14, abs=1e-15
    )


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 'a"b', "a\r\nb", "grün"])
def test_what_would_break_the_line_is_not_sent(value: float | str) -> None:
    with pytest.raises(ValueError, match="cannot be sent"):
        request(1, 1, value)


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        (b"%R1P,0,0:0", Reply(0, 0, 0)),
        (b"%R1P,0,12:1284,1.1,2.2,3.3", Reply(0, 12, 1284, ("1.1", "2.2", "3.3"))),
        (b"%R1P,3078,0:0", Reply(3078, 0, 0)),
        (b'%R1P,0,5:0,"TS60, 0.5"', Reply(0, 5, 0, ('"TS60, 0.5"',))),
        (b"%R1P,0,5:5", Reply(0, 5, 5)),
    ],
)
def test_a_reply_is_read(line: bytes, reply: Reply) -> None:
    assert parse_reply(line) == reply


@given(
    st.sampled_from([int(c) for c in GeoComCode]),
    st.integers(0, 32767),
    st.lists(st.floats(-1e5, 1e5).map(lambda x: f"{x:.9f}"), max_size=5),
)
def test_geocompy_reads_a_reply_with_check_sum_as_we_do(rc: int, transaction: int, values: list[str]) -> None:
    bare = ",".join([f"%R1P,0,{transaction}:{rc}", *values])
    head, _, tail = bare.partition(":")
    line = f"{head},{crc16_bytewise(bare)}:{tail}"
    theirs = Scripted(True).parse_response(f"%R1Q,1,{transaction}:", line, [float] * len(values))
    ours = parse_reply(line.encode())
    assert (ours.code, ours.transaction) == (theirs.error, theirs.trans)
    assert len(values) < 2 or ours.floats(len(values)) == list(theirs.params)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"?",
        b"%R1P,0,0",
        b"%R1Q,0,0:",
        b"R1P,0,0:0",
        b"%R1P,0,0:0\xff",
        b"%R1P,x,0:0",
        b'%R1P,0,1:0,"half',
        b"%R1P,0,1,1:0",
    ],
)
def test_what_is_no_reply_is_refused(line: bytes) -> None:
    with pytest.raises(Unreadable):
        parse_reply(line)


@given(st.integers(0, 40), st.integers(1, 255))
def test_any_damaged_byte_of_a_reply_with_check_sum_is_seen(place: int, flip: int) -> None:
    good = b"%R1P,0,9,30768:0,1.25,0.5,3.125"
    assert crc16_bytewise(b"%R1P,0,9:0,1.25,0.5,3.125") == 30768
    assert parse_reply(good, checksum=True).transaction == 9
    bad = bytearray(good)
    bad[place % len(bad)] ^= flip
    with pytest.raises(Unreadable):
        parse_reply(bytes(bad), checksum=True)


def test_a_reply_without_check_sum_is_refused_where_one_was_asked_for() -> None:
    with pytest.raises(Unreadable, match="check sum"):
        parse_reply(b"%R1P,0,9:0", checksum=True)


@pytest.mark.parametrize("values", [("1.0", "nan"), ("1.0",), ("1.0", "x"), ("1.0", ""), ("1.0", "inf")])
def test_numbers_that_are_missing_or_not_finite_are_refused(values: tuple[str, ...]) -> None:
    with pytest.raises(Unreadable):
        Reply(0, 1, 0, values).floats(2)


def test_every_code_of_the_table_is_the_one_that_geocompy_names_so() -> None:
    assert {n: c.name for n, c in CODES.items()} == {n: GeoComCode(n).name for n in CODES}


@pytest.mark.parametrize(
    ("number", "meaning"),
    [
        (0, Meaning.OK),
        (5, Meaning.UNKNOWN_CALL),
        (1283, Meaning.WARNING),
        (1284, Meaning.WARNING),
        (1285, Meaning.NO_DISTANCE),
        (1288, Meaning.NO_DISTANCE),
        (1289, Meaning.NO_DISTANCE),
        (1290, Meaning.ANGLES),
        (1291, Meaning.SETTING),
        (1292, Meaning.NO_DISTANCE),
        (1293, Meaning.BUSY),
        (1294, Meaning.NO_DISTANCE),
        (3077, Meaning.LINE),
        (3078, Meaning.LINE),
        (8704, Meaning.NO_TARGET),
        (8710, Meaning.NO_TARGET),
        (8711, Meaning.NO_TARGET),
        (8725, Meaning.NO_TARGET),
    ],
)
def test_the_codes_of_a_measurement_mean_what_they_should(number: int, meaning: Meaning) -> None:
    assert return_code(number).meaning is meaning


@pytest.mark.parametrize(
    "number", [n for n, c in CODES.items() if c.meaning not in (Meaning.OK, Meaning.WARNING)]
)
def test_every_failing_code_is_an_error_of_the_catalogue_that_says_its_number(number: int) -> None:
    told = return_code(number).as_error("tracker: TMC_DoMeasure")
    assert told.name in catalogue()
    assert str(number) in told.detail


def test_a_code_that_nobody_knows_is_told_with_its_number() -> None:
    told = return_code(40999).as_error("tracker: TMC_DoMeasure")
    assert told.name == "TRACKER_REFUSED"
    assert "40999, a return code that is not known here" in told.detail
