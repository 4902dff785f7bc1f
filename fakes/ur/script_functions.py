"""URScript's own functions in the twin: names, parameters and defaults are those of the URScript manual.

Every public method is a function of the language; one that takes time is a generator, a step per cycle.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from cell.poses import from_pose6, to_pose6
from fakes.ur.control_modes import ForceTask
from fakes.ur.runtime import ScriptError, Steps
from fakes.ur.script_values import Pose, Value, number, shown, six

if TYPE_CHECKING:
    from fakes.ur.robot import Robot

JOINT_SPEED, JOINT_ACCEL = 1.05, 1.4
TOOL_SPEED, TOOL_ACCEL = 0.25, 1.2
_MATHEMATICS: dict[str, Callable[..., float]] = {
    **{name: getattr(math, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2")},
    **{name: getattr(math, name) for name in ("sqrt", "floor", "ceil", "pow")},
    "d2r": math.radians,
    "r2d": math.degrees,
}


class ScriptFunctions:
    """Bound to one controller."""

    def __init__(self, robot: "Robot") -> None:
        self._robot, self._arm = robot, robot.arm

    def knows(self, name: str) -> bool:
        """Whether the twin has the function ``name``."""
        own = vars(type(self)).get(name)
        return name in _MATHEMATICS or (own is not None and name not in _NOT_OF_THE_LANGUAGE)

    def find(self, name: str) -> Callable[..., Any]:
        """The function ``name``; a script error when there is none."""
        if not self.knows(name):
            raise ScriptError(f"compile_error_name_not_found:{name}:")
        function: Callable[..., Any] = _MATHEMATICS.get(name) or getattr(self, name)
        return function

    # -- motion

    def movej(
        self, q: Value, a: Value = JOINT_ACCEL, v: Value = JOINT_SPEED, t: Value = 0.0, r: Value = 0.0
    ) -> Steps:
        _without_time("movej", t)
        goal = self._arm.inverse(six(q, "movej")) if isinstance(q, Pose) else six(q, "movej")
        yield from self._arm.move_joints(goal, number(v, "movej: v"), number(a, "movej: a"))

    def movel(
        self, pose: Value, a: Value = TOOL_ACCEL, v: Value = TOOL_SPEED, t: Value = 0.0, r: Value = 0.0
    ) -> Steps:
        _without_time("movel", t)
        goal = six(pose, "movel") if isinstance(pose, Pose) else self._arm.pose6(six(pose, "movel"))
        yield from self._arm.move_linear(goal, number(v, "movel: v"), number(a, "movel: a"))

    def movep(self, pose: Value, a: Value = TOOL_ACCEL, v: Value = TOOL_SPEED, r: Value = 0.0) -> Steps:
        yield from self.movel(pose, a, v)

    def servoj(
        self,
        q: Value,
        a: Value = 0.0,
        v: Value = 0.0,
        t: Value = 0.002,
        lookahead_time: Value = 0.1,
        gain: Value = 300.0,
    ) -> Steps:
        end = self._arm.t + number(t, "servoj: t")
        late = number(lookahead_time, "servoj: lookahead_time"), number(gain, "servoj: gain")
        self._arm.servo(six(q, "servoj"), number(t, "servoj: t"), *late)
        yield from self._wait(end)

    def speedj(self, qd: Value, a: Value = 0.5, t: Value = 0.0) -> Steps:
        yield from self._renew(lambda: self._arm.speed_joints(six(qd, "speedj"), number(a, "a")), t)

    def speedl(self, xd: Value, a: Value = 0.5, t: Value = 0.0, aRot: Value = 0.0) -> Steps:
        yield from self._renew(lambda: self._arm.speed_linear(six(xd, "speedl"), number(a, "a")), t)

    def stopj(self, a: Value = 2.0) -> Steps:
        yield from self._arm.stop(number(a, "stopj: a"), linear=False)

    def stopl(self, a: Value = 20.0, aRot: Value = 0.0) -> Steps:
        yield from self._arm.stop(number(a, "stopl: a"), linear=True)

    def sleep(self, t: Value) -> Steps:
        yield from self._wait(self._arm.t + number(t, "sleep: t"))

    def sync(self) -> Steps:
        yield

    def force_mode(
        self, task_frame: Value, selection_vector: Value, wrench: Value, type: Value, limits: Value
    ) -> None:
        task = ForceTask(
            six(task_frame, "force_mode"),
            six(selection_vector, "force_mode"),
            six(wrench, "force_mode"),
            six(limits, "force_mode"),
        )
        self._robot.modes.begin_force(task, int(number(type, "force_mode: type")))

    def end_force_mode(self) -> None:
        self._robot.modes.end()

    def force_mode_set_damping(self, damping: Value) -> None:
        self._robot.modes.set_damping(number(damping, "damping"))

    def force_mode_set_gain_scaling(self, scaling: Value) -> None:
        self._robot.modes.set_gain_scaling(number(scaling, "scaling"))

    def freedrive_mode(self, freeAxes: Value = None, feature: Value = None) -> None:
        self._robot.modes.begin_freedrive()

    def end_freedrive_mode(self) -> None:
        self._robot.modes.end()

    teach_mode, end_teach_mode = freedrive_mode, end_freedrive_mode

    def get_freedrive_status(self) -> Value:
        return self._robot.modes.freedrive_status

    def protective_stop(self) -> Steps:
        self._robot.protective_stop()
        yield

    # -- the arm

    def get_actual_joint_positions(self) -> Value:
        return _list(self._arm.q)

    get_target_joint_positions = get_actual_joint_positions

    def get_actual_joint_speeds(self) -> Value:
        return _list(self._arm.track.at(self._arm.t)[1])

    get_target_joint_speeds = get_actual_joint_speeds

    def get_actual_tcp_pose(self) -> Value:
        return _pose(self._arm.pose6(self._arm.q))

    get_target_tcp_pose = get_actual_tcp_pose

    def get_actual_tcp_speed(self) -> Value:
        return _list(self._arm.tcp_speed(*self._arm.track.at(self._arm.t)))

    get_target_tcp_speed = get_actual_tcp_speed

    def get_actual_tool_flange_pose(self) -> Value:
        return _pose(self._arm.pose6(self._arm.q, [0.0] * 6))

    def get_target_waypoint(self) -> Value:
        return _pose(self._arm.waypoint)

    def get_forward_kin(self, q: Value = None, tcp: Value = None) -> Value:
        joints = self._arm.q if q is None else six(q, "get_forward_kin")
        return _pose(self._arm.pose6(joints, None if tcp is None else six(tcp, "get_forward_kin")))

    def get_inverse_kin(
        self,
        x: Value,
        qnear: Value = None,
        maxPositionError: Value = 1e-10,
        maxOrientationError: Value = 1e-10,
    ) -> Value:
        near = None if qnear is None else six(qnear, "get_inverse_kin")
        return _list(self._arm.inverse(six(x, "get_inverse_kin"), near))

    def get_inverse_kin_has_solution(self, x: Value, qnear: Value = None) -> Value:
        try:
            self.get_inverse_kin(x, qnear)
        except ScriptError:
            return False
        return True

    def is_within_safety_limits(self, pose: Value) -> Value:
        if not isinstance(pose, Pose):
            return self._arm.within_limits(six(pose, "is_within_safety_limits"))
        return self.get_inverse_kin_has_solution(pose)

    def is_steady(self) -> Value:
        return not self._arm.moving(self._arm.t)

    def get_steptime(self) -> Value:
        return self._arm.period

    def get_tcp_force(self) -> Value:
        return list(self._robot.instant(self._arm.t).tcp_force)

    def force(self) -> Value:
        return self._robot.instant(self._arm.t).force_scalar

    def zero_ftsensor(self) -> None:
        self._robot.zero_force_sensor()

    def set_tcp(self, pose: Value) -> None:
        self._robot.set_tcp(six(pose, "set_tcp"))

    def get_tcp_offset(self) -> Value:
        return _pose(self._robot.tool.offset6)

    def set_payload(self, m: Value, cog: Value = None) -> None:
        centre = [0.0] * 3 if cog is None else cog
        if not isinstance(centre, list) or len(centre) != 3:
            raise ScriptError("set_payload: needs a centre of gravity of three numbers")
        self._robot.set_payload(number(m, "set_payload: m"), [number(c, "cog") for c in centre])

    def get_target_payload(self) -> Value:
        return self._robot.tool.payload

    def set_gravity(self, d: Value) -> None:
        if not isinstance(d, list) or len(d) != 3:
            raise ScriptError("set_gravity: needs three numbers")
        self._robot.tool.gravity = tuple(number(x, "set_gravity") for x in d)

    # -- poses and lists

    def pose_trans(self, p_from: Value, p_from_to: Value) -> Value:
        first, then = six(p_from, "pose_trans"), six(p_from_to, "pose_trans")
        return _pose(to_pose6(from_pose6(first) * from_pose6(then)))

    def pose_inv(self, p_from: Value) -> Value:
        return _pose(to_pose6(from_pose6(six(p_from, "pose_inv")).inv()))

    def norm(self, a: Value) -> Value:
        if isinstance(a, Pose | list):
            values = a.values if isinstance(a, Pose) else a
            return math.hypot(*(number(x, "norm") for x in values))
        return abs(number(a, "norm"))

    def abs(self, f: Value) -> Value:
        return math.fabs(number(f, "abs"))

    def length(self, v: Value) -> Value:
        if not isinstance(v, list | str):
            raise ScriptError("length: needs a list or a string")
        return len(v)

    def str_cat(self, op1: Value, op2: Value) -> Value:
        return shown(op1) + shown(op2)

    def to_str(self, val: Value) -> Value:
        return shown(val)

    def textmsg(self, s1: Value, s2: Value = "") -> None:
        self._robot.say(shown(s1) + shown(s2))

    # -- inputs, outputs and registers

    def set_standard_digital_out(self, n: Value, b: Value) -> None:
        self._write_bit(n, b, 0, 8)

    set_digital_out = set_standard_digital_out

    def set_configurable_digital_out(self, n: Value, b: Value) -> None:
        self._write_bit(n, b, 8, 8)

    def set_tool_digital_out(self, n: Value, b: Value) -> None:
        self._write_bit(n, b, 16, 2)

    def get_standard_digital_in(self, n: Value) -> Value:
        return bool(self._robot.digital_in(self._arm.t) >> _index(n, 8) & 1)

    get_digital_in = get_standard_digital_in

    def get_standard_digital_out(self, n: Value) -> Value:
        return bool(self._robot.io.digital_out >> _index(n, 8) & 1)

    get_digital_out = get_standard_digital_out

    def read_input_integer_register(self, address: Value) -> Value:
        return int(self._register("input_int", address))

    def read_output_integer_register(self, address: Value) -> Value:
        return int(self._register("output_int", address))

    def read_input_float_register(self, address: Value) -> Value:
        return float(self._register("input_double", address))

    def read_output_float_register(self, address: Value) -> Value:
        return float(self._register("output_double", address))

    def write_output_integer_register(self, address: Value, value: Value) -> None:
        name = f"output_int_register_{_index(address, 48)}"
        self._robot.registers[name] = int(number(value, "value"))

    def write_output_float_register(self, address: Value, value: Value) -> None:
        name = f"output_double_register_{_index(address, 48)}"
        self._robot.registers[name] = float(number(value, "value"))

    def write_output_boolean_register(self, address: Value, value: Value) -> None:
        self._robot.registers[f"output_bit_register_{_index(address, 128)}"] = int(value is True)

    def read_input_boolean_register(self, address: Value) -> Value:
        return bool(self._robot.registers.get(f"input_bit_register_{_index(address, 128)}", 0))

    # -- helpers

    def _wait(self, end: float) -> Steps:
        while self._arm.t < end:
            yield

    def _renew(self, command: Callable[[], None], t: Value) -> Steps:
        """A speed is held for ``t`` seconds; at least for one cycle."""
        end = self._arm.t + number(t, "t")
        command()
        yield
        while self._arm.t < end:
            command()
            yield

    def _write_bit(self, n: Value, b: Value, shift: int, width: int) -> None:
        bit = 1 << _index(n, width)
        self._robot.io.write_digital(shift, bit, bit if b else 0)

    def _register(self, kind: str, address: Value) -> float:
        return self._robot.registers.get(f"{kind}_register_{_index(address, 48)}", 0)


_NOT_OF_THE_LANGUAGE = frozenset(
    {"knows", "find", *(name for name in vars(ScriptFunctions) if name.startswith("_"))}
)


def _index(value: Value, count: int) -> int:
    index = int(number(value, "an address"))
    if not 0 <= index < count:
        raise ScriptError(f"the address {index} is not between 0 and {count - 1}")
    return index


def _without_time(function: str, t: Value) -> None:
    if t:
        raise ScriptError(f"{function}: the twin moves by speed, not in a given time t")


def _list(values: Any) -> Value:
    numbers: list[Value] = np.asarray(values, dtype=float).tolist()
    return numbers


def _pose(values: Any) -> Pose:
    return Pose(tuple(np.asarray(values, dtype=float).tolist()))
