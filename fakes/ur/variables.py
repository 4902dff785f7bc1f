"""The RTDE variables this controller knows: name, type, first PolyScope version, and how to read one.

Names and types are those of the public RTDE guide and of UR's C++ client library, which also knows
variables that the guide leaves out. A name that the selected version does not have is answered with
``NOT_FOUND``, as the real controller does. Where no source names a first version, every version has it.

What the twin's world has is read from it. The rest are constants: the twin has no motor currents,
temperatures, analogue inputs, energy meter, conveyor encoders or injection moulding interface.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from fakes.ur import wire

if TYPE_CHECKING:
    from fakes.ur.robot import Instant, Robot

Value = float | tuple[float, ...] | list[float]
Reader = Callable[["Robot", "Instant"], Value]
Version = tuple[int, ...]

ZERO6 = (0.0,) * 6
DOUBLE_REGISTERS = INT_REGISTERS = 48
BIT_REGISTERS = 128


@dataclass(frozen=True)
class Since:
    """The first version of each family that has a variable; None for a family without it."""

    e_series: Version | None = (5, 0)
    cb3: Version | None = (3, 2)
    x: Version | None = (10, 0)

    def includes(self, version: Version) -> bool:
        """Whether ``version`` has it."""
        first = self.cb3 if version[0] == 3 else self.x if version[0] >= 10 else self.e_series
        return first is not None and version >= first


ALWAYS = Since()
E_SERIES = Since(cb3=None)


@dataclass(frozen=True)
class Output:
    """One output variable."""

    type: str
    read: Reader
    since: Since = ALWAYS


@dataclass(frozen=True)
class Constant:
    """Reads what never changes."""

    value: Value

    def __call__(self, robot: "Robot", now: "Instant") -> Value:
        return self.value


@dataclass(frozen=True)
class FromRegisters:
    """Reads what changes only with the general purpose registers: one of them, or a word of bits."""

    names: tuple[str, ...]

    def __call__(self, robot: "Robot", now: "Instant") -> Value:
        get = robot.registers.get
        if len(self.names) == 1:
            return get(self.names[0], 0)
        return sum(1 << k for k, name in enumerate(self.names) if get(name, 0))


def _outputs() -> Iterator[tuple[str, Output]]:
    yield "timestamp", Output("DOUBLE", lambda r, s: s.stamp)
    for side in ("target", "actual"):
        yield f"{side}_q", Output("VECTOR6D", lambda r, s: s.q)
        yield f"{side}_qd", Output("VECTOR6D", lambda r, s: s.qd)
        yield f"{side}_current", Output("VECTOR6D", Constant(ZERO6))
        yield f"{side}_TCP_pose", Output("VECTOR6D", lambda r, s: s.tcp_pose6)
        yield f"{side}_TCP_speed", Output("VECTOR6D", lambda r, s: s.tcp_speed)
    yield "target_qdd", Output("VECTOR6D", lambda r, s: s.qdd)
    yield "target_moment", Output("VECTOR6D", Constant(ZERO6))
    yield "actual_current_window", Output("VECTOR6D", Constant(ZERO6))
    yield "actual_current_as_torque", Output("VECTOR6D", Constant(ZERO6), Since((5, 23), None))
    yield "joint_control_output", Output("VECTOR6D", Constant(ZERO6))
    yield "actual_TCP_force", Output("VECTOR6D", lambda r, s: s.tcp_force)
    yield "tcp_force_scalar", Output("DOUBLE", lambda r, s: s.force_scalar)
    yield "ft_raw_wrench", Output("VECTOR6D", lambda r, s: s.raw_wrench, Since((5, 9), None))
    # Not in the guide; its versions are those that UR gives with its C++ client library.
    yield "tcp_offset", Output("VECTOR6D", lambda r, s: r.tool.offset6, Since((5, 5, 1), (3, 12)))
    with_payload = Since((5, 5, 1), (3, 11))
    yield "payload", Output("DOUBLE", lambda r, s: r.tool.payload, with_payload)
    yield "payload_cog", Output("VECTOR3D", lambda r, s: r.tool.centre_of_gravity, with_payload)
    yield "payload_inertia", Output("VECTOR6D", lambda r, s: r.tool.inertia, Since((5, 11), (3, 15)))
    yield from _dynamics()
    yield from _states()
    yield from _electrical()
    yield from _registers()


def _dynamics() -> Iterator[tuple[str, Output]]:
    for side in ("target", "actual"):
        yield f"{side}_TCP_acceleration", Output("VECTOR6D", lambda r, s: s.tcp_acceleration, E_SERIES)
    yield "wrench_calc_from_currents", Output("VECTOR6D", lambda r, s: s.contact_force, E_SERIES)
    # Actual joints are the target ones here, so they never deviate.
    yield "joint_position_deviation_ratio", Output("DOUBLE", Constant(0.0), E_SERIES)
    yield "collision_detection_ratio", Output("DOUBLE", lambda r, s: s.collision_ratio, E_SERIES)
    yield "target_gravity", Output("VECTOR3D", lambda r, s: r.tool.gravity, Since((5, 26), None, (10, 12)))
    newest = Since((5, 26), None, (10, 14))
    yield "target_base_acceleration", Output("VECTOR6D", Constant(ZERO6), newest)
    yield "target_base_wrench", Output("VECTOR6D", Constant(ZERO6), newest)


def _states() -> Iterator[tuple[str, Output]]:
    yield "robot_mode", Output("INT32", lambda r, s: r.safety.robot_mode)
    yield "joint_mode", Output("VECTOR6INT32", lambda r, s: r.safety.joint_modes)
    yield "safety_mode", Output("INT32", lambda r, s: r.safety.mode)
    yield "safety_status", Output("INT32", lambda r, s: r.safety.mode, Since((5, 4)))
    yield "runtime_state", Output("UINT32", lambda r, s: r.runtime.state)
    yield "robot_status_bits", Output("UINT32", lambda r, s: r.robot_status_bits)
    yield "safety_status_bits", Output("UINT32", lambda r, s: r.safety.status_bits)
    yield "speed_scaling", Output("DOUBLE", lambda r, s: r.speed_scaling)
    yield "target_speed_fraction", Output("DOUBLE", lambda r, s: r.io.speed_fraction)
    yield "actual_momentum", Output("DOUBLE", Constant(0.0))
    yield "actual_execution_time", Output("DOUBLE", Constant(0.4))
    yield "target_execution_time", Output("DOUBLE", lambda r, s: 1000.0 / r.rate, E_SERIES)
    yield "control_step", Output("UINT64", lambda r, s: s.control_step, Since((5, 26), None, (10, 13)))
    yield "script_control_line", Output("UINT32", lambda r, s: r.script_line, E_SERIES)
    yield "time_scale_source", Output("INT32", Constant(0), E_SERIES)
    yield "elbow_position", Output("VECTOR3D", lambda r, s: s.elbow_position)
    yield "elbow_velocity", Output("VECTOR3D", lambda r, s: s.elbow_velocity)
    yield "actual_tool_accelerometer", Output("VECTOR3D", Constant((0.0, 0.0, 9.81)))


def _electrical() -> Iterator[tuple[str, Output]]:
    yield "joint_temperatures", Output("VECTOR6D", Constant((30.0,) * 6))
    yield "actual_main_voltage", Output("DOUBLE", Constant(48.0))
    yield "actual_robot_voltage", Output("DOUBLE", lambda r, s: 48.0 if r.safety.powered else 0.0)
    yield "actual_robot_current", Output("DOUBLE", lambda r, s: 1.2 if r.safety.powered else 0.0)
    yield "actual_joint_voltage", Output("VECTOR6D", Constant((48.0,) * 6))
    yield "actual_digital_input_bits", Output("UINT64", lambda r, s: r.digital_in(s.t))
    yield "actual_digital_output_bits", Output("UINT64", lambda r, s: r.io.digital_out)
    configurable = (
        ("input", lambda r, s: r.digital_in(s.t) >> 8 & 0xFF),
        ("output", lambda r, s: r.io.digital_out >> 8 & 0xFF),
    )
    for way, read in configurable:
        yield f"actual_configurable_digital_{way}_bits", Output("UINT64", read, E_SERIES)
    yield "analog_io_types", Output("UINT32", Constant(0))
    for k in (0, 1):
        yield f"standard_analog_input{k}", Output("DOUBLE", Constant(0.0))
        yield f"standard_analog_output{k}", Output("DOUBLE", _analog_output(k))
        yield f"tool_analog_input{k}", Output("DOUBLE", Constant(0.0))
    yield "io_current", Output("DOUBLE", Constant(0.0))
    yield "tool_mode", Output("UINT32", Constant(253))
    yield "tool_analog_input_types", Output("UINT32", Constant(0))
    yield "tool_output_voltage", Output("INT32", Constant(0))
    yield "tool_output_current", Output("DOUBLE", Constant(0.0))
    yield "tool_temperature", Output("DOUBLE", Constant(30.0))
    yield from _not_fitted()


def _not_fitted() -> Iterator[tuple[str, Output]]:
    """What this controller is not fitted with, and what the twin does not model: always zero."""
    for name in ("tool_output_mode", "tool_digital_output0_mode", "tool_digital_output1_mode"):
        yield name, Output("UINT8", Constant(0), E_SERIES)
    second_supply = Since(None, None, (10, 15))
    yield "tool_output_voltage_2", Output("INT32", Constant(0), second_supply)
    yield "tool_output_current_2", Output("DOUBLE", Constant(0.0), second_supply)
    for name in ("euromap67_input_bits", "euromap67_output_bits"):
        yield name, Output("UINT32", Constant(0))
    for name in ("euromap67_24V_voltage", "euromap67_24V_current"):
        yield name, Output("DOUBLE", Constant(0.0))
    for name in ("actual_robot_energy_consumed", "actual_robot_braking_energy_dissipated"):
        yield name, Output("DOUBLE", Constant(0.0), E_SERIES)
    for name in ("encoder0_raw", "encoder1_raw"):
        yield name, Output("INT32", Constant(0), E_SERIES)


def _analog_output(k: int) -> Reader:
    return lambda r, s: r.io.analog_out[k]


def _registers() -> Iterator[tuple[str, Output]]:
    def value(name: str) -> Reader:
        return FromRegisters((name,))

    for way in ("output", "input"):
        for k in range(INT_REGISTERS):
            yield (name := f"{way}_int_register_{k}"), Output("INT32", value(name))
            yield (name := f"{way}_double_register_{k}"), Output("DOUBLE", value(name))
        for k in range(BIT_REGISTERS):
            yield (name := f"{way}_bit_register_{k}"), Output("BOOL", value(name))
        for low, high in ((0, 31), (32, 63)):
            bits = [f"{way}_bit_register_{k}" for k in range(low, high + 1)]
            yield f"{way}_bit_registers{low}_to_{high}", Output("UINT32", FromRegisters(tuple(bits)))


OUTPUTS: dict[str, Output] = dict(_outputs())

INPUTS: dict[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "external_force_torque": "VECTOR6D",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    **{f"input_bit_register_{k}": "BOOL" for k in range(64, BIT_REGISTERS)},
    **{f"input_int_register_{k}": "INT32" for k in range(INT_REGISTERS)},
    **{f"input_double_register_{k}": "DOUBLE" for k in range(DOUBLE_REGISTERS)},
}


def output(name: str, version: Version) -> Output | None:
    """The output variable ``name`` of PolyScope ``version``, or None when that version lacks it."""
    found = OUTPUTS.get(name)
    return found if found is not None and found.since.includes(version) else None


class OutputRecipe:
    """The variables one client subscribed to, compiled to runs of neighbours that change together."""

    def __init__(self, names: list[str], version: Version) -> None:
        self.variables = [output(name, version) for name in names]
        self.types = [v.type if v is not None else wire.NOT_FOUND for v in self.variables]
        self.valid = bool(names) and wire.NOT_FOUND not in self.types
        known = [v for v in self.variables if v is not None]
        self._runs = [_Run(kind, tuple(run)) for kind, run in groupby(known, lambda v: _kind(v.read))]

    def pack(self, robot: "Robot", now: "Instant") -> bytes:
        """The values at ``now``, without recipe id and header."""
        return b"".join([run.pack(robot, now) for run in self._runs])


_STATE, _REGISTERS, _CONSTANTS = range(3)


def _kind(read: Reader) -> int:
    if isinstance(read, Constant):
        return _CONSTANTS
    return _REGISTERS if isinstance(read, FromRegisters) else _STATE


class _Run:
    """Neighbours in a recipe: constants are packed once, registers when one was written, the rest always."""

    def __init__(self, kind: int, variables: tuple[Output, ...]) -> None:
        self._kind = kind
        self._readers = [(v.read, wire.TYPES[v.type][1] > 1) for v in variables]
        self._struct = wire.Layout(tuple(v.type for v in variables)).struct
        self._packed, self._revision = b"", -1

    def pack(self, robot: "Robot", now: "Instant") -> bytes:
        if self._kind != _STATE:
            revision = robot.registers.revision if self._kind == _REGISTERS else 0
            if revision == self._revision:
                return self._packed
            self._revision = revision
        values: list[float] = []
        for read, is_vector in self._readers:
            if is_vector:
                values += read(robot, now)  # type: ignore[arg-type]
            else:
                values.append(read(robot, now))  # type: ignore[arg-type]
        self._packed = self._struct.pack(*values)
        return self._packed
