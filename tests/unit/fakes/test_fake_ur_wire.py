"""Framing, types and recipes of the fake controller's RTDE, against the guide and by properties."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.ur import wire
from fakes.ur.robot import Identity, Robot
from fakes.ur.rtde import InputOwnership
from fakes.ur.variables import INPUTS, OUTPUTS, OutputRecipe, output
from fakes.world.arm.kinematics import chain
from fakes.world.arm.track import Track

PACKAGES = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=200)), max_size=10)
HOME = np.array([0.0, -1.8, 1.8, -1.57, -1.57, 0.0])
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
        ("tcp_offset", (5, 5, 0), False),
        ("tcp_offset", (5, 5, 1), True),
        ("tcp_offset", (5, 12), True),
        ("tcp_offset", (3, 11, 0), False),
        ("tcp_offset", (3, 12, 0), True),
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
        ("tool_output_mode", (5, 0), True),
        ("tool_output_mode", (3, 15), False),
        ("target_gravity", (5, 25, 9), False),
        ("target_gravity", (5, 26), True),
        ("control_step", (10, 12), False),
        ("control_step", (10, 13), True),
        ("tool_output_voltage_2", (5, 26), False),
        ("tool_output_voltage_2", (10, 15), True),
        ("target_base_wrench", (10, 13), False),
        ("target_base_wrench", (10, 14), True),
    ],
)
def test_a_variable_is_known_from_its_version_on(name: str, version: tuple[int, ...], known: bool) -> None:
    assert (output(name, version) is not None) is known


# What UR's C++ client library knows beyond the guide's older editions, with the types it gives.
BEYOND_THE_GUIDE = {
    "actual_TCP_acceleration": "VECTOR6D",
    "target_TCP_acceleration": "VECTOR6D",
    "actual_configurable_digital_input_bits": "UINT64",
    "actual_configurable_digital_output_bits": "UINT64",
    "target_execution_time": "DOUBLE",
    "actual_robot_energy_consumed": "DOUBLE",
    "actual_robot_braking_energy_dissipated": "DOUBLE",
    "encoder0_raw": "INT32",
    "encoder1_raw": "INT32",
    "euromap67_input_bits": "UINT32",
    "euromap67_output_bits": "UINT32",
    "euromap67_24V_voltage": "DOUBLE",
    "euromap67_24V_current": "DOUBLE",
    "tool_output_mode": "UINT8",
    "tool_digital_output0_mode": "UINT8",
    "tool_digital_output1_mode": "UINT8",
    "joint_position_deviation_ratio": "DOUBLE",
    "collision_detection_ratio": "DOUBLE",
    "wrench_calc_from_currents": "VECTOR6D",
    "script_control_line": "UINT32",
    "time_scale_source": "INT32",
    "target_gravity": "VECTOR3D",
    "target_base_acceleration": "VECTOR6D",
    "control_step": "UINT64",
    "target_base_wrench": "VECTOR6D",
    "tcp_offset": "VECTOR6D",
}


@pytest.mark.parametrize(("name", "type_name"), BEYOND_THE_GUIDE.items())
def test_a_variable_of_the_client_library_is_known_with_its_type(name: str, type_name: str) -> None:
    for version in ((5, 26), (10, 14)):
        known = output(name, version)
        assert known is not None
        assert known.type == type_name


@pytest.mark.parametrize("version", [(3, 15, 8), (5, 4), (5, 12, 4), (5, 26), (10, 14)])
def test_every_variable_of_a_version_can_be_packed(version: tuple[int, ...]) -> None:
    robot = Robot(Identity(), Track(0.0, HOME), chain("ur10e"), lambda: 1.0)
    names = [name for name in OUTPUTS if output(name, version) is not None]
    recipe = OutputRecipe(names, version)
    assert recipe.valid
    unpacked = wire.Layout(tuple(recipe.types)).unpack(recipe.pack(robot, robot.step(1.0)))
    assert len(unpacked) == len(names)


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


def test_a_package_shows_every_register_that_was_written_since_the_package_before() -> None:
    robot = Robot(Identity(), Track(100.0, HOME), chain("ur10e"), lambda: 100.0)
    names = ["output_int_register_3", "input_bit_registers0_to_31", "actual_main_voltage", "speed_scaling"]
    subject = OutputRecipe(names, (5, 12))

    def shown() -> tuple[float, ...]:
        return struct.unpack(">iIdd", subject.pack(robot, robot.instant(robot.now())))

    assert shown() == (0, 0, 48.0, 1.0)
    robot.registers["output_int_register_3"] = 7
    robot.io.speed_fraction = 0.5
    assert shown() == (7, 0, 48.0, 0.5)
    robot.inputs.write({"input_bit_registers0_to_31": 5}, robot.now())
    assert shown() == (7, 5, 48.0, 0.5)
    robot.registers.clear()
    assert shown() == (0, 0, 48.0, 0.5)
