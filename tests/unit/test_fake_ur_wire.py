"""Framing, types and recipes of the fake controller's RTDE, against the guide and by properties."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.ur import wire
from fakes.ur.rtde import InputOwnership
from fakes.ur.variables import INPUTS, OUTPUTS, OutputRecipe, output

PACKAGES = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=200)), max_size=10)
NONE: frozenset[str] = frozenset()


@pytest.fixture
def subject() -> wire.Framer:
    return wire.Framer()


@given(packages=PACKAGES, cuts=st.lists(st.integers(1, 40), max_size=60))
def test_packages_survive_any_cutting_of_the_stream(
    packages: list[tuple[int, bytes]], cuts: list[int]
) -> None:
    framer, found = wire.Framer(), []
    stream = b"".join(wire.package(kind, payload) for kind, payload in packages)
    for cut in [*cuts, len(stream)]:
        found += list(framer.feed(stream[:cut]))
        stream = stream[cut:]
    assert found == packages


@pytest.mark.parametrize("size", [0, 1, 2])
def test_a_size_below_the_header_is_no_rtde(subject: wire.Framer, size: int) -> None:
    with pytest.raises(wire.FramingError):
        list(subject.feed(struct.pack(">HB", size, ord("V"))))


def test_the_version_request_has_the_bytes_of_the_guide() -> None:
    assert wire.package(wire.Package.PROTOCOL_VERSION, b"\x00\x02") == bytes([0, 5, 86, 0, 2])


def test_a_text_message_has_lengths_in_version_two_and_only_a_level_in_version_one() -> None:
    two = wire.text_message("hot", wire.Level.WARNING, version=2, source="arm")
    assert two == b"\x00\x0c" + b"M" + b"\x03hot" + b"\x03arm" + b"\x02"
    one = wire.text_message("hot", wire.Level.WARNING, version=1)
    assert one == b"\x00\x07" + b"M" + b"\x02hot"


def test_names_may_end_with_a_comma() -> None:
    assert wire.split_names(b"timestamp,actual_q,") == ["timestamp", "actual_q"]


def test_a_layout_unpacks_scalars_and_vectors() -> None:
    layout = wire.Layout(("UINT8", "VECTOR3D", "INT32", "BOOL"))
    values = layout.unpack(struct.pack(">B3di?", 7, 1.0, 2.0, 3.0, -5, True))
    assert values == [7, (1.0, 2.0, 3.0), -5, True]
    with pytest.raises(ValueError, match="5 bytes where the recipe has 30"):
        layout.unpack(b"\x00" * 5)


@pytest.mark.parametrize(
    ("name", "version", "known"),
    [
        ("actual_q", (3, 15), True),
        ("tcp_offset", (5, 12), False),
        ("tcp_offset", (5, 15), True),
        ("ft_raw_wrench", (5, 8), False),
        ("ft_raw_wrench", (5, 9), True),
        ("ft_raw_wrench", (3, 15), False),
        ("payload", (5, 5, 0), False),
        ("payload", (5, 5, 1), True),
        ("payload", (3, 11, 0), True),
        ("payload_inertia", (3, 15), True),
        ("payload_inertia", (5, 10), False),
        ("actual_current_as_torque", (5, 23), True),
        ("actual_current_as_torque", (10, 10), True),
    ],
)
def test_a_variable_is_known_from_its_version_on(name: str, version: tuple[int, ...], known: bool) -> None:
    assert (output(name, version) is not None) is known


def test_every_variable_has_a_type_of_the_guide() -> None:
    assert {v.type for v in OUTPUTS.values()} <= set(wire.TYPES)
    assert set(INPUTS.values()) <= set(wire.TYPES)


def test_a_recipe_without_names_or_with_unknown_ones_is_not_valid() -> None:
    assert not OutputRecipe([], (5, 12)).valid
    assert not OutputRecipe(["timestamp", "nonsense"], (5, 12)).valid
    assert OutputRecipe(["timestamp", "timestamp"], (5, 12)).valid


def test_ownership_is_all_or_nothing_and_goes_with_its_owner() -> None:
    ownership, first, second = InputOwnership(), object(), object()
    assert ownership.claim(["input_int_register_0"], first, NONE) == ["INT32"]
    wish = ["input_int_register_1", "input_int_register_0"]
    assert ownership.claim(wish, second, NONE) == ["INT32", "IN_USE"]
    assert "input_int_register_1" not in ownership.owners
    ownership.release(first)
    assert ownership.claim(wish, second, NONE) == ["INT32", "INT32"]
    assert ownership.claim(wish, second, NONE) == ["INT32", "INT32"]
