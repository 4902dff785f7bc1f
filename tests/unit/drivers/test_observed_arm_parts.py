"""What an observed arm's driver is made of: numbers in registers, rest, rows of a file, and its section."""

import struct
from math import nan, pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.modbus.registers import Span, Table
from drivers.observed_arm import ObservedArmConfig
from drivers.observed_arm.config import JointConfig
from drivers.observed_arm.registers import spans
from drivers.observed_arm.rest import RestWatch
from drivers.observed_arm.rows import BadRow, JointRow, JointTable, TableChanged, TableFormat

URL = "tcp://192.168.10.40:502"


# -- numbers


@pytest.mark.parametrize(
    ("keys", "words", "joint"),
    [
        # 1.0f is 3F800000, 90.0f is 42B40000; 90 000 is 00015F90.
        ({}, [0x3F80, 0x0000], 1.0),
        ({"word_order": "low-first"}, [0x0000, 0x3F80], 1.0),
        ({"unit": "deg"}, [0x42B4, 0x0000], pi / 2),
        ({"type": "int32", "unit": "deg", "scale": 0.001}, [0x0001, 0x5F90], pi / 2),
        ({"type": "int32", "unit": "deg", "scale": 0.001}, [0xFFFE, 0xA070], -pi / 2),
        ({"type": "int16", "unit": "deg", "scale": 0.01}, [9000], pi / 2),
        ({"type": "int32", "unit": "counts", "counts_per_turn": 360000.0}, [0x0001, 0x5F90], pi / 2),
        ({"type": "int32", "unit": "counts", "counts_per_turn": -360000.0}, [0x0001, 0x5F90], -pi / 2),
        ({"type": "int32", "unit": "counts", "counts_per_turn": 4000, "zero": 89000}, [1, 0x5F90], pi / 2),
        ({"type": "int32", "unit": "mm", "scale": 0.01}, [0x0001, 0x5F90], 0.9),
        ({"unit": "m"}, [0x3F80, 0x0000], 1.0),
    ],
)
def test_a_joint_is_what_its_section_says_and_is_written_the_same_way(
    keys: dict[str, Any], words: list[int], joint: float
) -> None:
    encoding = JointConfig(address=0, **keys).encoding
    assert encoding.decode(words) == pytest.approx(joint, rel=1e-9)
    assert encoding.encode(joint) == words


@given(
    q=st.floats(-6.0, 6.0),
    kind=st.sampled_from(["float32", "int32"]),
    unit=st.sampled_from(["rad", "deg"]),
    order=st.sampled_from(["high-first", "low-first"]),
    zero=st.floats(-100, 100),
)
def test_what_is_written_reads_back_within_a_step(
    q: float, kind: Any, unit: Any, order: Any, zero: float
) -> None:
    scale = 1e-4 if kind == "int32" else 1.0
    encoding = JointConfig(address=0, type=kind, unit=unit, word_order=order, scale=scale, zero=zero).encoding
    assert abs(encoding.decode(encoding.encode(q)) - q) <= max(
        encoding.step * 0.51 if kind == "int32" else 0, 2e-5
    )


def test_a_joint_that_the_registers_cannot_hold_is_refused() -> None:
    small = JointConfig(address=0, type="int16", unit="deg", scale=0.001).encoding
    with pytest.raises(ValueError, match="does not fit into int16"):
        small.encode(pi)
    with pytest.raises(ValueError, match="no number"):
        small.encode(nan)
    with pytest.raises(ValueError, match="does not fit into float32"):
        JointConfig(address=0, scale=1e-6).encoding.encode(1e36)


def test_a_float_that_is_none_is_seen_as_that() -> None:
    words = list(struct.unpack(">HH", struct.pack(">f", nan)))
    assert np.isnan(JointConfig(address=0).encoding.decode(words))


def test_only_registers_that_were_named_are_read() -> None:
    named = {(Table.HOLDING, a) for a in (0, 1, 2, 3, 6, 7)} | {(Table.INPUT, 4)}
    assert spans(named) == [Span(Table.HOLDING, 0, 4), Span(Table.HOLDING, 6, 2), Span(Table.INPUT, 4, 1)]


# -- rest


def watch(path: Any, moving: Any = lambda t: False, period: float = 0.05, skip: Any = ()) -> list[float]:
    """The times at which an arm on ``path(t)`` is said to rest."""
    subject = RestWatch(window_s=0.5, spread=1e-4, period_s=period)
    times = [k * period for k in range(100) if k not in skip]
    return [t for t in times if subject.take(t, np.array([path(t), 0.0]), moving(t))]


def test_an_arm_rests_once_its_joints_have_kept_still_for_the_window() -> None:
    assert watch(lambda t: 0.3)[0] == pytest.approx(0.5)
    rests = watch(lambda t: min(t, 2.0))
    assert rests[0] == pytest.approx(2.5, abs=0.051)
    assert watch(lambda t: 0.0002 * (round(t / 0.05) % 2)) == []
    assert len(watch(lambda t: 0.00005 * (round(t / 0.05) % 2))) == 90


def test_a_slow_creep_is_no_rest() -> None:
    assert watch(lambda t: 0.0004 * t) == []
    assert watch(lambda t: 0.0001 * t)


def test_the_arms_own_word_that_it_moves_counts_at_once_and_begins_the_window_anew() -> None:
    rests = watch(lambda t: 0.3, moving=lambda t: 2.0 <= t < 2.04)
    assert not [t for t in rests if 1.99 < t < 2.5]
    assert [t for t in rests if t > 2.5]


def test_a_window_with_holes_decides_nothing() -> None:
    rests = watch(lambda t: 0.3, skip=range(40, 49))
    assert not [t for t in rests if 2.0 <= t < 2.5]
    assert rests[-1] > 4.9


# -- rows

COLUMNS = ["q1", "q2"]


def table(columns: list[str] = COLUMNS, **keys: Any) -> JointTable:
    return JointTable(columns, [JointConfig(**keys).encoding for _ in columns])


def test_rows_that_are_there_at_first_are_the_past_and_each_new_one_is_told() -> None:
    subject = table()
    begun = b"# serial: 1234\nq1,q2\n0.1,0.2\n"
    assert subject.begin(begun) == 1
    assert subject.serial == "1234"
    assert subject.read(begun) == []
    more = begun + b"0.3,0.4\r\n\n# lunch\n0.5,-0.6\n"
    assert subject.read(more) == [JointRow(4, (0.3, 0.4), None), JointRow(7, (0.5, -0.6), None)]
    assert subject.read(more) == []


def test_a_row_counts_once_its_line_is_ended() -> None:
    subject = table()
    subject.begin(b"q1,q2\n")
    assert subject.read(b"q1,q2\n0.1,0.2") == []
    assert subject.unfinished
    assert subject.read(b"q1,q2\n0.1,0.25\n") == [JointRow(2, (0.1, 0.25), None)]
    assert not subject.unfinished


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_columns_are_found_by_name_whatever_their_order_and_unit(mark: str) -> None:
    subject = table(["axis2", "axis1"], unit="deg")
    head = mark.join(["t", "axis1", "note", "axis2", "pose"]) + "\n"
    subject.begin(b"\xef\xbb\xbf" + head.encode())
    rows = subject.read(
        b"\xef\xbb\xbf" + (head + mark.join(["1.5", "90", "sealed", "-45", "7"]) + "\n").encode()
    )
    (row,) = rows
    assert isinstance(row, JointRow)
    assert row.pose == 7
    np.testing.assert_allclose(row.q, [-pi / 4, pi / 2])


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("0.1", "it has 1 fields, the header 4"),
        ("1,0.1,x,", "q2 = 'x' is no number"),
        ("1,0.1,nan,", "q2 = 'nan' is no finite number"),
        ("1,,0.2,", "q1 = '' is no number"),
        ("1,0.1,0.2,0", "pose = '0' is no number from 1"),
        ("1,0.1,0.2,two", "pose = 'two'"),
        ("soon,0.1,0.2,", "t = 'soon' is no number"),
        ("0.5,0.1,0.2,", "its t = 0.5 is not after the 0.9 before it"),
        ("1,0.1,0.2,3,4", "it has 5 fields"),
    ],
)
def test_a_row_that_cannot_be_used_is_told_with_its_line_and_the_next_one_counts(line: str, why: str) -> None:
    subject = table()
    begun = b"t,q1,q2,pose\n0.9,0,0,\n"
    subject.begin(begun)
    bad, good = subject.read(begun + f"{line}\n5,0.3,0.4,\n".encode())
    assert isinstance(bad, BadRow)
    assert bad.number == 3
    assert why in bad.why
    assert good == JointRow(4, (0.3, 0.4), None)


def test_an_old_row_that_is_changed_or_gone_is_noticed() -> None:
    begun = b"q1,q2\n0.1,0.2\n"
    for changed in (b"q1,q2\n0.1,0.3\n0.5,0.6\n", b"q1,q2\n", b""):
        subject = table()
        subject.begin(begun)
        with pytest.raises(TableChanged):
            subject.read(changed)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"", "has no header; its first line should be q1,q2"),
        (b"# serial: 1\n", "has no header"),
        (b"q1,q3\n", "has no column q2"),
        (b"q1,q2,q1\n", "names a column twice"),
        (b"0.1,0.2\n", "has no column q1, q2"),
    ],
)
def test_a_table_without_the_columns_is_refused(text: bytes, why: str) -> None:
    with pytest.raises(TableFormat) as caught:
        table().begin(text)
    assert why in str(caught.value)


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), max_size=8), st.data())
def test_rows_are_the_same_however_the_file_grows(
    rows: list[tuple[float, float]], data: st.DataObject
) -> None:
    text = b"q1,q2\n" + b"".join(f"{a!r},{b!r}\n".encode() for a, b in rows)
    subject, found = table(), []
    subject.begin(text[:6])
    for end in sorted(data.draw(st.lists(st.integers(6, len(text)), max_size=5))):
        found += subject.read(text[:end])
    found += subject.read(text)
    assert [row.q for row in found if isinstance(row, JointRow)] == rows


# -- the section


def section(**keys: Any) -> ObservedArmConfig:
    return ObservedArmConfig(**{"url": URL, "joints": [{"address": 0}, {"address": 2}], **keys})


def test_nothing_is_written_unless_the_section_says_so() -> None:
    assert section().allow_requests is False
    assert section(handshake={"targets": [20, 22], "number": 28}).allow_requests is False


HANDSHAKE = {"targets": [20, 22], "number": 28, "reached": 10}


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"url": "tls://h:1"}, "should begin with tcp://, rtu:// or file://"),
        ({"url": "file://here/j.csv"}, "with three slashes"),
        ({"url": "file:///j.csv"}, "address is about registers"),
        ({"url": "file:///j.csv", "joints": [{}], "moving": {"address": 1}}, "moving is about registers"),
        ({"url": "file:///j.csv", "joints": [{}], "allow_requests": True}, "allow_requests is about"),
        ({"url": "file:///j.csv", "joints": [{"column": "t"}]}, "should differ from each other"),
        ({"url": "file:///j.csv", "joints": [{"column": "q2"}, {}]}, "should differ from each other"),
        ({"joints": [{"column": "q1"}]}, "joint 1 has no address, or a column"),
        ({"joints": [{"address": 0, "unit": "counts"}]}, "counts_per_turn belong together"),
        ({"joints": [{"address": 0, "counts_per_turn": 9.0}]}, "counts_per_turn belong together"),
        ({"joints": [{"address": 0, "unit": "counts", "counts_per_turn": 0.5}]}, "less than one count"),
        ({"joints": [{"address": 0, "unit": "grad"}]}, "rad"),
        ({"allow_requests": True}, "allow_requests needs a handshake"),
        (
            {"allow_requests": True, "handshake": {"targets": [20, 22], "number": 28}},
            "allow_requests needs handshake.reached",
        ),
        ({"handshake": {"targets": [20], "number": 28}}, "has 1 addresses for 2 joints"),
        ({"handshake": {"targets": [20, 21], "number": 28}}, "overlap each other"),
        ({"handshake": {"targets": [20, 22], "number": 23}}, "overlap each other"),
        ({"handshake": {"targets": [20, 22], "number": 3}}, "is also one of the joints'"),
        ({"handshake": {"targets": [1, 22], "number": 28}}, "is also one of the joints'"),
        ({"rest_window_s": 0.05}, "should be at least twice poll_period_s"),
        ({"joints": []}, "at least 1"),
    ],
)  # fmt: skip
def test_a_section_that_cannot_be_meant_is_refused_in_words(keys: dict[str, Any], why: str) -> None:
    with pytest.raises(ValidationError) as caught:
        section(**keys)
    assert why in str(caught.value)


def test_a_right_section_is_taken() -> None:
    subject = section(handshake=HANDSHAKE, allow_requests=True, moving={"address": 8, "bit": 3})
    assert subject.link.address.host == "192.168.10.40"
    file = ObservedArmConfig(url="file:///var/joints.csv", joints=[{}, {"column": "wrist"}])  # type: ignore[list-item]
    assert file.columns == ["q1", "wrist"]
    assert file.path == "/var/joints.csv"
    # Joints in input registers may have the addresses of what is written to holding registers.
    section(
        joints=[{"address": 20, "table": "input"}, {"address": 22, "table": "input"}], handshake=HANDSHAKE
    )
