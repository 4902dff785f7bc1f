"""Runs the URScript subset on the arm, one control cycle per step."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from fakes.ur.runtime import ScriptError, Steps
from fakes.ur.urscript import Argument, Call, Forever, Pose, Source, Statement, six_numbers

if TYPE_CHECKING:
    from fakes.ur.robot import Robot

CYCLE_S = 0.002
_MOTION = frozenset({"movej", "movel", "movep", "stopj", "stopl", "sleep", "sync"})
# Defaults of the URScript manual.
_JOINT_SPEED, _JOINT_ACCEL = 1.05, 1.4
_TOOL_SPEED, _TOOL_ACCEL = 0.25, 1.2
_STOPJ_DECEL, _STOPL_DECEL = 2.0, 20.0


class Interpreter:
    """Statements to steps. ``hooks`` are functions that the surrounding program adds, by name."""

    def __init__(self, robot: "Robot", hooks: dict[str, Callable[[float], None]] | None = None) -> None:
        self._robot, self._arm = robot, robot.arm
        self._hooks = hooks or {}

    def knows(self, statements: Sequence[Statement]) -> tuple[int, str] | None:
        """The first call that is unknown, with its line; None when all are known."""
        for statement in statements:
            if isinstance(statement, Forever):
                inner = self.knows(statement.body)
                if inner is not None:
                    return inner
            elif statement.function not in self._hooks and not hasattr(self, f"_do_{statement.function}"):
                return statement.line, f"function {statement.function} is not known"
        return None

    def run(self, statements: Sequence[Statement]) -> Steps:
        """The statements' steps."""
        for statement in statements:
            if isinstance(statement, Forever):
                while True:
                    yield from self.run(statement.body)
                    yield
            elif statement.function in self._hooks:
                self._hooks[statement.function](_number(statement, 0, "value"))
            else:
                yield from self._call(statement)

    def _call(self, call: Call) -> Steps:
        try:
            yield from getattr(self, f"_do_{call.function}")(call)
        except ScriptError as exc:
            raise ScriptError(exc.text, call.line) from exc

    # -- the functions, named as in the URScript manual

    def _do_movej(self, call: Call) -> Steps:
        target, numbers = _target(call)
        goal = self._arm.inverse(numbers) if isinstance(target, Pose) else numbers
        v, a = _number(call, 2, "v", _JOINT_SPEED), _number(call, 1, "a", _JOINT_ACCEL)
        yield from self._arm.move_joints(goal, v, a)

    def _do_movel(self, call: Call) -> Steps:
        target, numbers = _target(call)
        goal = numbers if isinstance(target, Pose) else self._arm.pose6(numbers)
        v, a = _number(call, 2, "v", _TOOL_SPEED), _number(call, 1, "a", _TOOL_ACCEL)
        yield from self._arm.move_linear(goal, v, a)

    _do_movep = _do_movel

    def _do_stopj(self, call: Call) -> Steps:
        yield from self._arm.stop(_number(call, 0, "a", _STOPJ_DECEL), linear=False)

    def _do_stopl(self, call: Call) -> Steps:
        yield from self._arm.stop(_number(call, 0, "a", _STOPL_DECEL), linear=True)

    def _do_sleep(self, call: Call) -> Steps:
        end = self._arm.t + _number(call, 0, "t")
        while self._arm.t < end:
            yield

    def _do_sync(self, call: Call) -> Steps:
        yield

    def _do_textmsg(self, call: Call) -> Steps:
        self._robot.say("".join(str(part) for part in call.positional))
        yield from ()

    def _do_set_tcp(self, call: Call) -> Steps:
        self._robot.set_tcp(_target(call)[1])
        yield from ()

    def _do_set_payload(self, call: Call) -> Steps:
        self._robot.tool.payload = _number(call, 0, "m")
        yield from ()

    def _do_set_standard_digital_out(self, call: Call) -> Steps:
        bit = 1 << int(_number(call, 0, "n"))
        self._robot.io.write_digital(0, bit, bit if _number(call, 1, "b") else 0)
        yield from ()

    _do_set_digital_out = _do_set_standard_digital_out

    def _do_write_output_integer_register(self, call: Call) -> Steps:
        index = int(_number(call, 0, "address"))
        self._robot.registers[f"output_int_register_{index}"] = int(_number(call, 1, "value"))
        yield from ()


def secondary_steps(robot: "Robot", source: Source) -> Steps:
    """A secondary program: it runs beside the main one and must not take physical time."""
    for statement in source.statements:
        if isinstance(statement, Forever) or statement.function in _MOTION:
            raise ScriptError("a secondary program must not take physical time", statement.line)
    yield from Interpreter(robot).run(source.statements)


def _argument(call: Call, index: int, name: str) -> Argument | None:
    return call.positional[index] if index < len(call.positional) else call.named.get(name)


def _number(call: Call, index: int, name: str, default: float | None = None) -> float:
    value = _argument(call, index, name)
    value = default if value is None else value
    if isinstance(value, int | float):
        return float(value)
    raise ScriptError(f"{call.function}: {name} must be a number", call.line)


def _target(call: Call) -> tuple[Argument, Sequence[float]]:
    value = call.positional[0] if call.positional else call.named.get("pose", "")
    numbers = six_numbers(value)
    if numbers is None:
        raise ScriptError(f"{call.function}: needs a pose or six joint angles", call.line)
    return value, numbers
