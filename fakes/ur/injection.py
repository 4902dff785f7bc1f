"""How each fault of the vocabulary shows on a UR controller."""

import asyncio
import os
import signal
from collections.abc import Callable, Coroutine
from typing import Any

from cell.errors import error
from fakes.faults.actions import Action, Actions, Arguments, amount, switch
from fakes.faults.vocabulary import Fault, number
from fakes.ur.controller import Controller
from fakes.ur.dashboard import foreign_steps
from fakes.ur.runtime import Program, RuntimeState, ScriptError
from fakes.ur.safety import SafetyMode
from fakes.ur.variables import INPUTS, OUTPUTS

_JUNK = bytes(range(256))


class ControllerFaults:
    """Injects faults into one controller; lasting ones end after ``for_s`` seconds or with ``clear``."""

    def __init__(self, controller: Controller) -> None:
        self._controller, self._robot = controller, controller.robot
        self._tasks: set[asyncio.Task[None]] = set()
        self._actions = Actions(self._stream_actions() | self._arm_actions())

    def offers(self) -> frozenset[Fault]:
        """Every fault a controller can show."""
        return self._actions.offers()

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``for_s`` ends it by itself. ``ARGUMENT_INVALID`` for what it does not take."""
        self._actions.inject(fault, arguments)

    def clear(self) -> None:
        """An operator puts all right: faults end, the arm is powered and remote, paused programs stop."""
        self._actions.end_all()
        if self._robot.runtime.state in (RuntimeState.PAUSED, RuntimeState.PAUSING):
            self._robot.runtime.stop(self._robot.now())
        self._robot.safety.restore()

    def close(self) -> None:
        """Forget timers and reboots on their way."""
        self._actions.forget_timers()
        for task in self._tasks:
            task.cancel()

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _stream_actions(self) -> dict[Fault, Action]:
        stream = self._controller.faults

        return {
            Fault.REFUSE: Action(self._refuse, lambda: self._spawn(self._controller.listen())),
            Fault.DROP: Action(lambda a: self._cut(a, reset=False), takes=frozenset({"ports"})),
            Fault.RESET: Action(lambda a: self._cut(a, reset=True), takes=frozenset({"ports"})),
            Fault.HALF_OPEN: switch(stream.link, "half_open"),
            Fault.SPLIT: switch(stream.link, "split"),
            Fault.DELAY: amount(stream.link, "delay_s", 0.05),
            Fault.JUNK: Action(self._junk),
            Fault.SILENCE: switch(stream, "silent"),
            Fault.FREEZE: switch(stream, "freeze"),
            Fault.DUPLICATE: switch(stream, "duplicate"),
            Fault.GAP: Action(self._gap, takes=frozenset({"count"})),
            Fault.CLOCK_JUMP: Action(self._clock_jump, takes=frozenset({"s"})),
            Fault.LATE_FIRST_PACKAGE: amount(stream, "first_package_delay_s", 2.0),
            Fault.SLOW_DASHBOARD: amount(stream, "dashboard_delay_s", 1.0),
            Fault.HANDSHAKE_MESSAGE: Action(
                lambda a: setattr(stream, "handshake_message", str(a.get("text", "controller is busy"))),
                lambda: setattr(stream, "handshake_message", None),
                frozenset({"text"}),
            ),
            Fault.NOT_FOUND: Action(
                self._not_found, lambda: setattr(stream, "missing", frozenset()), frozenset({"name"})
            ),
        }

    def _arm_actions(self) -> dict[Fault, Action]:
        robot = self._robot

        def release(*modes: SafetyMode) -> Callable[[], None]:
            return lambda: robot.safety.release(*modes)

        return {
            Fault.PROTECTIVE_STOP: Action(lambda a: robot.protective_stop()),
            Fault.EMERGENCY_STOP: Action(
                lambda a: robot.emergency_stop(), release(SafetyMode.ROBOT_EMERGENCY_STOP)
            ),
            Fault.SAFEGUARD_STOP: Action(
                lambda a: robot.safeguard_stop(), release(SafetyMode.SAFEGUARD_STOP)
            ),
            Fault.REDUCED_MODE: Action(lambda a: robot.safety.reduce(), release(SafetyMode.REDUCED)),
            Fault.LOCAL_MODE: Action(
                lambda a: setattr(robot, "remote", False), lambda: setattr(robot, "remote", True)
            ),
            Fault.FOREIGN_PROGRAM: Action(
                lambda a: robot.start(Program("foreign", foreign_steps(), "foreign")),
                self._end_foreign_program,
            ),
            Fault.REGISTER_IN_USE: Action(
                self._register_in_use,
                lambda: self._controller.rtde.ownership.release(self),
                frozenset({"name"}),
            ),
            Fault.SPEED_SLIDER: Action(
                lambda a: robot.slide(number(a, "fraction", 0.5)),
                lambda: robot.slide(1.0),
                frozenset({"fraction"}),
            ),
            Fault.SCRIPT_DEATH: Action(lambda a: self._script_death()),
            Fault.REBOOT: Action(self._reboot, takes=frozenset({"off_s", "serial"})),
            Fault.KILL: Action(lambda a: os.kill(os.getpid(), signal.SIGKILL)),
        }

    # -- transport

    def _refuse(self, arguments: Arguments) -> None:
        self._spawn(self._controller.refuse())
        self._controller.cut()

    def _cut(self, arguments: Arguments, reset: bool) -> None:
        ports = arguments.get("ports", "all")
        if ports not in ("all", "rtde"):
            raise error("ARGUMENT_INVALID", f"ports={ports!r} is neither all nor rtde")
        self._controller.cut(reset, rtde_only=ports == "rtde")

    def _junk(self, arguments: Arguments) -> None:
        for connection in self._controller.rtde.connections:
            connection.send(_JUNK)
        self._controller.primary.send(_JUNK)

    # -- stream

    def _gap(self, arguments: Arguments) -> None:
        self._controller.faults.drop_packages = int(number(arguments, "count", 50, low=1))

    def _clock_jump(self, arguments: Arguments) -> None:
        self._robot.clock_offset += number(arguments, "s", 10.0, low=-1e6)

    # -- programs and registers

    def _end_foreign_program(self) -> None:
        program = self._robot.runtime.program
        if program is not None and program.kind == "foreign":
            self._robot.runtime.stop(self._robot.now())

    def _script_death(self) -> None:
        runtime = self._robot.runtime
        name = runtime.program.name if runtime.program is not None else ""
        if runtime.state != RuntimeState.STOPPED:
            runtime.stop(self._robot.now())
            failure = ScriptError("get_inverse_kin: unable to find an inverse kinematics solution")
            self._robot.report(name, failure)

    def _register_in_use(self, arguments: Arguments) -> None:
        name = arguments.get("name", "input_int_register_0")
        if name not in INPUTS:
            raise error("ARGUMENT_INVALID", f"name={name!r} is not an input variable")
        self._controller.rtde.ownership.owners[name] = self

    def _not_found(self, arguments: Arguments) -> None:
        name = arguments.get("name", "ft_raw_wrench")
        if name not in INPUTS and name not in OUTPUTS:
            raise error("ARGUMENT_INVALID", f"name={name!r} is not an RTDE variable")
        faults = self._controller.faults
        faults.missing = faults.missing | {name}

    # -- dashboard and device

    def _reboot(self, arguments: Arguments) -> None:
        serial = str(arguments.get("serial", self._robot.identity.serial))
        if not serial.isdigit() or not serial.startswith("9999"):
            raise error(
                "ARGUMENT_INVALID", f"serial={serial!r}: twin serials are digits that begin with 9999"
            )
        self._spawn(self._controller.reboot(number(arguments, "off_s", 2.0), serial))
