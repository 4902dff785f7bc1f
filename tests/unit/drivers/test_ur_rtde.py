"""The RTDE codec, judged by bytes of the public guide and by round trips."""

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.errors import CellError
from drivers.ur import rtde
from drivers.ur.rtde import Package, PackageType, Recipe, Splitter

_INT32 = st.integers(-(2**31), 2**31 - 1)
_UINT32 = st.integers(0, 2**32 - 1)
_DOUBLE = st.floats(allow_nan=False)
_VALUES: dict[str, st.SearchStrategy[rtde.Value]] = {
    "BOOL": st.booleans(),
    "UINT8": st.integers(0, 255),
    "UINT32": _UINT32,
    "UINT64": st.integers(0, 2**64 - 1),
    "INT32": _INT32,
    "DOUBLE": _DOUBLE,
    "VECTOR3D": st.tuples(*[_DOUBLE] * 3),
    "VECTOR6D": st.tuples(*[_DOUBLE] * 6),
    "VECTOR6INT32": st.tuples(*[_INT32] * 6),
    "VECTOR6UINT32": st.tuples(*[_UINT32] * 6),
}
_PACKAGES = st.builds(Package, st.sampled_from(list(PackageType)), st.binary(max_size=200))


def test_the_version_request_is_the_five_bytes_of_the_guide() -> None:
    assert rtde.request_version() == bytes([0, 5, ord("V"), 0, 2])


def test_an_output_request_carries_a_double_frequency_and_the_names() -> None:
    wire = rtde.request_outputs(["timestamp", "actual_q"], 125.0)
    assert wire == b"\x00\x1dO" + struct.pack(">d", 125.0) + b"timestamp,actual_q"


def test_an_input_request_carries_the_names_only() -> None:
    assert rtde.request_inputs(["a", "b"]) == b"\x00\x06Ia,b"


def test_a_recipe_reply_with_a_trailing_comma_is_understood() -> None:
    assert rtde.parse_recipe(["timestamp"], b"\x01DOUBLE,").types == ("DOUBLE",)


def test_a_recipe_reply_may_say_that_a_variable_is_missing_or_taken() -> None:
    subject = rtde.parse_recipe(["a", "b"], b"\x00NOT_FOUND,IN_USE")
    assert subject.types == ("NOT_FOUND", "IN_USE")


@pytest.mark.parametrize("reply", [b"", b"\x01DOUBLE,DOUBLE", b"\x01NONSENSE"])
def test_a_recipe_reply_that_does_not_answer_the_question_is_a_violation(reply: bytes) -> None:
    with pytest.raises(CellError) as caught:
        rtde.parse_recipe(["timestamp"], reply)
    assert caught.value.name == "PROTOCOL_VIOLATION"


def test_the_controller_version_is_four_numbers() -> None:
    assert rtde.parse_controller_version(struct.pack(">4I", 5, 12, 4, 1101)) == (5, 12, 4, 1101)


@given(st.data(), st.lists(st.sampled_from(sorted(_VALUES)), min_size=1, max_size=12))
def test_values_survive_packing_and_unpacking(data: st.DataObject, types: list[str]) -> None:
    names = tuple(f"v{k}" for k in range(len(types)))
    subject = Recipe(3, names, tuple(types))
    values = {n: data.draw(_VALUES[t]) for n, t in zip(names, types, strict=True)}
    assert subject.unpack(subject.pack(values)) == values


def test_a_double_is_eight_bytes_most_significant_first() -> None:
    subject = Recipe(1, ("x",), ("DOUBLE",))
    assert subject.pack({"x": 1.0}) == b"\x01\x3f\xf0\x00\x00\x00\x00\x00\x00"


@pytest.mark.parametrize("payload", [b"", b"\x02" + bytes(8), b"\x01" + bytes(7), b"\x01" + bytes(9)])
def test_a_package_of_another_recipe_or_length_is_a_violation(payload: bytes) -> None:
    with pytest.raises(CellError) as caught:
        Recipe(1, ("x",), ("DOUBLE",)).unpack(payload)
    assert caught.value.name == "PROTOCOL_VIOLATION"


@given(st.lists(_PACKAGES, max_size=8), st.lists(st.integers(1, 60), max_size=40))
def test_packages_come_out_whole_however_the_stream_is_cut(packages: list[Package], cuts: list[int]) -> None:
    wire = b"".join(rtde.encode(p.kind, p.payload) for p in packages)
    subject = Splitter()
    found: list[Package] = []
    at = 0
    for cut in [*cuts, len(wire)]:
        found += subject.feed(wire[at : at + cut])
        at += cut
    assert found == packages


@given(st.binary(min_size=3, max_size=300))
def test_junk_is_a_violation_or_waits_for_more_but_never_crashes(data: bytes) -> None:
    subject = Splitter()
    with contextlib.suppress(AbortedByViolation):
        packages = _feed(subject, data)
        assert sum(len(p.payload) + 3 for p in packages) <= len(data)


class AbortedByViolation(Exception):
    """The one error that junk may raise."""


def _feed(subject: Splitter, data: bytes) -> list[Package]:
    try:
        return subject.feed(data)
    except CellError as exc:
        if exc.name != "PROTOCOL_VIOLATION":
            raise
        raise AbortedByViolation from exc


@pytest.mark.parametrize("header", [b"\x00\x02U", b"\x00\x00U", b"\x00\x10Z"])
def test_an_impossible_header_is_a_violation_at_once(header: bytes) -> None:
    with pytest.raises(CellError) as caught:
        Splitter().feed(header)
    assert caught.value.name == "PROTOCOL_VIOLATION"
