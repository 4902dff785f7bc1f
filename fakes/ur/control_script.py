"""The behaviour of ur-rtde's control script: commands in input registers, answers in output registers.

The script itself is not interpreted. It is recognised when it is uploaded, its register offset and an
injected path are read from it, and this class then behaves as it does: one pass of the main loop per
control cycle, blocking commands block the loop, "threads" run beside it.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cell.poses import from_pose6, to_pose6
from fakes.ur.interpreter import Interpreter
from fakes.ur.registers import Registers
from fakes.ur.runtime import ScriptError, Steps
from fakes.ur.special_commands import SpecialCommands, refusal
from fakes.ur.urscript import Statement, read_statements

if TYPE_CHECKING:
    from fakes.ur.robot import Robot

READY, DONE = 1, 2
STOP_SCRIPT = 255
CONTACT_DECEL = 3.0
FORCE_STOP_DECEL = 10.0
CONTACT_FORCE_N = 5.0  # stands for the controller's own sensing of a contact
# Commands that the client repeats without waiting: executed in every cycle while they stand in the register.
REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})

_ENDED = object()
_SIGNATURE = "RTDE Control Script Loaded"
_OFFSET = re.compile(r"# int register offset\s*\n\s*(\d+)")
_PATH = re.compile(r"# inject move path[ \t]*\n(.*?)^[ \t]*end[ \t]*$", re.S | re.M)


@dataclass(frozen=True)
class ControlScript:
    """What is read from an uploaded control script."""

    offset: int
    path: tuple[Statement, ...]


def recognise(text: str) -> ControlScript | None:
    """The parameters of ur-rtde's control script, or None when ``text`` is another program."""
    if _SIGNATURE not in text:
        return None
    offset, path = _OFFSET.search(text), _PATH.search(text)
    lines = enumerate(path.group(1).splitlines(), start=1) if path else ()
    return ControlScript(int(offset.group(1)) if offset else 0, read_statements(lines))


class AsyncProgress:
    """The progress word in output_int_2: progress, running bit, change count and operation id."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._writes = self._operation = 0

    def write(self, value: int) -> None:
        """Progress ``value``; 0 begins an operation, a negative one ends it."""
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        word = self._writes << 16 | self._operation << 24
        if value >= 0:
            word += min(value, 32767) + 32768
        self._registers.int_out(2, word)


class ControlProgram:
    """One run of the control script."""

    def __init__(self, robot: "Robot", script: ControlScript) -> None:
        self._robot, self._arm, self._path = robot, robot.arm, script.path
        self._registers = Registers(robot.registers, script.offset)
        self._offset = script.offset
        self._progress = AsyncProgress(self._registers)
        self._threads: dict[str, Steps] = {}
        self._speed: Callable[[], None] | None = None
        self._speed_linear = True
        self._servo: tuple[list[float], float, float, float] | None = None
        self._circular: tuple[list[float], float, float] | None = None
        self._jog: tuple[list[float], float] | None = None
        self._contact_seen = False
        self._contact_watch: list[float] | None = None
        self._commands = self._command_table()
        self._special = SpecialCommands(robot, self._registers).table()

    def steps(self) -> Steps:
        """The script's main loop."""
        self._progress.write(-1)
        self._registers.int_out(0, READY)
        executing = False
        while True:
            command = self._registers.int_in(0)
            if command == STOP_SCRIPT:
                return
            if command in REALTIME:
                yield from self._execute(command)
                self._registers.int_out(0, READY)
            elif command == 0:
                executing = False
                self._registers.int_out(0, READY)
            elif not executing:
                yield from self._beside(self._execute(command))
                executing = True
            self._run_threads()
            yield

    def _execute(self, command: int) -> Steps:
        action = self._commands.get(command) or self._special.get(command)
        why_not = refusal(command, self._robot.identity.version, action is not None)
        if action is None or why_not:
            raise ScriptError(why_not)
        yield from action() or ()
        self._registers.int_out(0, DONE)

    def _beside(self, steps: Steps) -> Steps:
        """A blocking command: the main loop stands still, the threads go on."""
        for _ in steps:
            self._run_threads()
            yield

    def _run_threads(self) -> None:
        for name, thread in tuple(self._threads.items()):
            if next(thread, _ENDED) is _ENDED:
                del self._threads[name]
        if self._speed is not None:
            self._speed()
        if self._servo is not None:
            self._arm.servo(*self._servo)
        if self._jog is not None:
            self._arm.speed_linear(*self._jog)
        if self._contact_watch is not None and self._touches(self._contact_watch):
            self._contact_seen, self._contact_watch = True, None
            self._kill_move()
            self._threads["contact"] = self._arm.stop(CONTACT_DECEL, linear=True)

    # -- threads of the script

    def _kill_move(self) -> None:
        if self._threads.pop("move", None) is not None:
            self._progress.write(-1)

    def _operation(self, steps: Steps) -> Steps:
        self._progress.write(0)
        yield from steps
        self._progress.write(-1)

    def _start_or_run(self, steps: Steps) -> Steps:
        """Moves: in the background when input_int_1 says so, else blocking."""
        self._kill_move()
        if self._registers.int_in(1) == 1:
            self._threads["move"] = self._operation(steps)
        else:
            yield from steps

    def _stop(self, linear: bool) -> Steps:
        decel, background = self._registers.double_in(0), self._registers.int_in(1) == 1
        stopping = self._threads.pop("stop", None) is not None
        if stopping:
            self._progress.write(-1)
        else:
            self._kill_move()
        # The script runs every background stop as stopl, whichever was asked for.
        steps = self._arm.stop(decel, linear=linear or background)
        if background:
            self._threads["stop"] = self._operation(steps)
        else:
            yield from steps

    # -- commands

    def _command_table(self) -> dict[int, Callable[[], Steps | None]]:
        """Motion, and what is computed from the joints; the rest is in :mod:`special_commands`."""
        r, arm, robot = self._registers, self._arm, self._robot
        out = r.vector_out
        return {
            1: lambda: self._start_or_run(arm.move_joints(r.vector_in(0), r.double_in(6), r.double_in(7))),
            2: lambda: self._start_or_run(
                arm.move_joints(arm.inverse(r.vector_in(0)), r.double_in(6), r.double_in(7))
            ),
            3: lambda: self._start_or_run(arm.move_linear(r.vector_in(0), r.double_in(6), r.double_in(7))),
            4: lambda: self._start_or_run(
                arm.move_linear(arm.pose6(r.vector_in(0)), r.double_in(6), r.double_in(7))
            ),
            7: self._end_force_mode,
            9: lambda: self._begin_speed(linear=False),
            10: lambda: self._begin_speed(linear=True),
            11: lambda: self._begin_servo(r.vector_in(0)),
            12: self._begin_circular_servo,
            15: self._speed_stop,
            16: self._servo_stop,
            24: lambda: self._begin_servo(list(arm.inverse(r.vector_in(0)))),
            25: lambda: r.int_out(1, int(self._touches(r.vector_in(0)))),
            26: lambda: out([arm.period]),
            27: lambda: out(arm.track.at(arm.t - arm.period * r.int_in(1))[0]),
            30: lambda: out(arm.inverse(r.vector_in(0), r.vector_in(6))),
            31: robot.protective_stop,
            33: lambda: self._stop(linear=True),
            34: lambda: self._stop(linear=False),
            35: lambda: robot.set_watchdog(f"input_int_register_{self._offset}", r.double_in(0)),
            36: lambda: r.int_out(1, int(self._reachable(r.vector_in(0), arm.q))),
            37: lambda: r.int_out(1, int(arm.within_limits(r.vector_in(0)))),
            39: lambda: out(to_pose6(from_pose6(r.vector_in(0)) * from_pose6(r.vector_in(6)))),
            41: self._begin_jog,
            42: self._stop_jog,
            43: lambda: out(arm.pose6(arm.q)),
            44: lambda: out(arm.pose6(r.vector_in(0), r.vector_in(6))),
            45: lambda: self._start_or_run(self._follow_path()),
            46: lambda: out(arm.inverse(r.vector_in(0))),
            47: lambda: r.int_out(1, int(not arm.moving(arm.t))),
            51: self._until_contact,
            58: lambda: out(arm.pose6(arm.q, [0.0] * 6)),
            60: lambda: r.int_out(1, int(self._reachable(r.vector_in(0), arm.q))),
            61: lambda: r.int_out(1, int(self._reachable(r.vector_in(0), r.vector_in(6)))),
            62: self._watch_contact,
            63: self._unwatch_contact,
            64: lambda: r.int_out(1, int(self._contact_seen)),
        }

    def _reachable(self, pose6: ArrayLike, q_near: ArrayLike) -> bool:
        try:
            return self._arm.within_limits(self._arm.inverse(pose6, q_near))
        except ScriptError:
            return False

    def _begin_speed(self, linear: bool) -> None:
        r = self._registers
        target, accel = r.vector_in(0), r.double_in(6)
        command = self._arm.speed_linear if linear else self._arm.speed_joints
        self._speed, self._speed_linear = (lambda: command(target, accel)), linear

    def _speed_stop(self) -> Steps:
        self._speed = None
        yield from self._arm.stop(self._registers.double_in(0), self._speed_linear)

    def _begin_servo(self, q: list[float]) -> None:
        r = self._registers
        self._servo = (q, r.double_in(8), r.double_in(9), r.double_in(10))

    def _servo_stop(self) -> Steps:
        self._servo = self._circular = None
        self._threads.pop("servoc", None)
        yield from self._arm.stop(self._registers.double_in(0), linear=True)

    def _begin_circular_servo(self) -> None:
        """servoc: the TCP moves to the pose and rests there; the twin does not blend into the next one."""
        r = self._registers
        self._circular = r.vector_in(0), r.double_in(6), r.double_in(7)
        if "servoc" not in self._threads:
            self._threads["servoc"] = self._circular_servo()

    def _circular_servo(self) -> Steps:
        while (target := self._circular) is not None:
            yield from self._arm.move_linear(*target)
            while self._circular is target:
                yield

    def _end_force_mode(self) -> Steps:
        self._robot.modes.end()
        yield from self._arm.stop(FORCE_STOP_DECEL, linear=True)

    def _begin_jog(self) -> None:
        r, arm = self._registers, self._arm
        feature = int(r.double_in(6))
        q = arm.q
        frame = {1: arm.pose6(q), 2: np.array([r.double_in(8 + k) for k in range(6)])}.get(feature)
        turn = from_pose6(frame if frame is not None else [0.0] * 6).rotation
        xd = r.vector_in(0)
        self._jog = ([*turn.apply(xd[:3]), *turn.apply(xd[3:])], r.double_in(7))

    def _stop_jog(self) -> Steps:
        self._jog = None
        yield from self._arm.stop(1.2, linear=True)

    def _follow_path(self) -> Steps:
        hooks = {"signal_async_progress": lambda value: self._progress.write(int(value))}
        yield from Interpreter(self._robot, hooks).run(self._path)

    # -- contact

    def _touches(self, direction: ArrayLike) -> bool:
        """Whether something pushes against motion along ``direction``; any direction when it is null."""
        force = np.asarray(self._robot.contact_force())[:3]
        along = np.asarray(direction, dtype=float)[:3]
        length = float(np.linalg.norm(along))
        pushed = float(np.linalg.norm(force)) if length < 1e-10 else float(-force @ along) / length
        return pushed > CONTACT_FORCE_N

    def _until_contact(self) -> Steps:
        xd, direction, accel = (
            self._registers.vector_in(0),
            self._registers.vector_in(6),
            self._registers.double_in(12),
        )
        while not self._touches(direction if any(direction) else xd):
            self._arm.speed_linear(xd, accel)
            yield
        touched = self._arm.q
        yield from self._arm.stop(CONTACT_DECEL, linear=True)
        yield from self._arm.move_linear(self._arm.pose6(touched), 0.25, 1.2)

    def _watch_contact(self) -> None:
        self._contact_seen, self._contact_watch = False, self._registers.vector_in(0)

    def _unwatch_contact(self) -> None:
        self._contact_watch = None
        self._registers.int_out(1, int(self._contact_seen))
