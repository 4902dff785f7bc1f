"""How each fault of the vocabulary shows on a UR controller."""

import asyncio
import os
import signal
from collections.abc import Callable, Mapping
from typing import Any

from cell.errors import error
from fakes.faults import Fault, number
from fakes.ur.controller import Controller
from fakes.ur.dashboard import foreign_steps
from fakes.ur.runtime import Program, RuntimeState, ScriptError
from fakes.ur.safety import SafetyMode
from fakes.ur.variables import INPUTS, OUTPUTS

Arguments = Mapping[str, Any]
_JUNK = bytes(range(256))


class ControllerFaults:
    """Injects faults into one controller; lasting ones end with ``clear`` or after ``for_s`` seconds."""

    def __init__(self, controller: Controller) -> None:
        self._controller, self._robot = controller, controller.robot
        self._tasks: set[asyncio.Task[None]] = set()
        self._timers: list[asyncio.TimerHandle] = []
        stream = controller.faults
        self._actions: dict[Fault, tuple[Callable[[Arguments], None], frozenset[str]]] = {
            Fault.REFUSE: (self._refuse, frozenset()),
            Fault.DROP: (lambda a: self._cut(a, reset=False), frozenset({"ports"})),
            Fault.RESET: (lambda a: self._cut(a, reset=True), frozenset({"ports"})),
            Fault.HALF_OPEN: (lambda a: setattr(stream.link, "half_open", True), frozenset()),
            Fault.SILENCE: (lambda a: setattr(stream, "silent", True), frozenset()),
            Fault.DELAY: (self._delay, frozenset({"s"})),
            Fault.SPLIT: (lambda a: setattr(stream.link, "split", True), frozenset()),
            Fault.JUNK: (self._junk, frozenset()),
            Fault.FREEZE: (lambda a: setattr(stream, "freeze", True), frozenset()),
            Fault.DUPLICATE: (lambda a: setattr(stream, "duplicate", True), frozenset()),
            Fault.GAP: (self._gap, frozenset({"count"})),
            Fault.CLOCK_JUMP: (self._clock_jump, frozenset({"s"})),
            Fault.PROTECTIVE_STOP: (lambda a: self._robot.protective_stop(), frozenset()),
            Fault.EMERGENCY_STOP: (lambda a: self._robot.emergency_stop(), frozenset()),
            Fault.SAFEGUARD_STOP: (lambda a: self._robot.safeguard_stop(), frozenset()),
            Fault.LOCAL_MODE: (lambda a: setattr(self._robot, "remote", False), frozenset()),
            Fault.FOREIGN_PROGRAM: (self._foreign_program, frozenset()),
            Fault.REGISTER_IN_USE: (self._register_in_use, frozenset({"name"})),
            Fault.NOT_FOUND: (self._not_found, frozenset({"name"})),
            Fault.HANDSHAKE_MESSAGE: (self._handshake_message, frozenset({"text"})),
            Fault.SCRIPT_DEATH: (self._script_death, frozenset()),
            Fault.LATE_FIRST_PACKAGE: (self._late_first_package, frozenset({"s"})),
            Fault.SLOW_DASHBOARD: (self._slow_dashboard, frozenset({"s"})),
            Fault.REBOOT: (self._reboot, frozenset({"off_s", "serial"})),
            Fault.KILL: (lambda a: os.kill(os.getpid(), signal.SIGKILL), frozenset()),
        }

    def offers(self) -> frozenset[Fault]:
        """Every fault a controller can show."""
        return frozenset(self._actions)

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``for_s`` ends it by itself. ``ARGUMENT_INVALID`` for what it does not take."""
        action, allowed = self._actions[fault]
        unknown = set(arguments) - allowed - {"for_s"}
        if unknown:
            takes = ", ".join(sorted(allowed | {"for_s"}))
            raise error(
                "ARGUMENT_INVALID", f"{fault} does not take {', '.join(sorted(unknown))}; it takes {takes}"
            )
        duration = number(arguments, "for_s", 0.0)
        action(arguments)
        if duration > 0:
            self._timers.append(asyncio.get_running_loop().call_later(duration, self.clear))

    def clear(self) -> None:
        """End every lasting fault: links behave, stops are released, control is remote again."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        self._controller.faults.clear()
        self._robot.remote = True
        self._robot.safety.release(
            SafetyMode.SAFEGUARD_STOP, SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP
        )
        self._controller.rtde.ownership.release(self)
        self._spawn(self._controller.listen())

    def close(self) -> None:
        """Forget timers and running reboots."""
        for timer in self._timers:
            timer.cancel()
        for task in self._tasks:
            task.cancel()

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # -- transport

    def _refuse(self, arguments: Arguments) -> None:
        self._spawn(self._controller.refuse())
        self._controller.cut()

    def _cut(self, arguments: Arguments, reset: bool) -> None:
        ports = arguments.get("ports", "all")
        if ports not in ("all", "rtde"):
            raise error("ARGUMENT_INVALID", f"ports={ports!r} is neither all nor rtde")
        self._controller.cut(reset, rtde_only=ports == "rtde")

    def _delay(self, arguments: Arguments) -> None:
        self._controller.faults.link.delay_s = number(arguments, "s", 0.05)

    def _junk(self, arguments: Arguments) -> None:
        for connection in self._controller.rtde.connections:
            connection.send(_JUNK)
        self._controller.primary.send(_JUNK)

    # -- stream

    def _gap(self, arguments: Arguments) -> None:
        self._controller.faults.drop_packages = int(number(arguments, "count", 50, low=1))

    def _clock_jump(self, arguments: Arguments) -> None:
        self._robot.clock_offset += number(arguments, "s", 10.0, low=-1e6)

    def _late_first_package(self, arguments: Arguments) -> None:
        self._controller.faults.first_package_delay_s = number(arguments, "s", 2.0)

    # -- programs and registers

    def _foreign_program(self, arguments: Arguments) -> None:
        self._robot.start(Program("foreign", foreign_steps(), "foreign"))

    def _script_death(self, arguments: Arguments) -> None:
        runtime = self._robot.runtime
        name = runtime.program.name if runtime.program is not None else ""
        if runtime.state != RuntimeState.STOPPED:
            runtime.stop(self._robot.now())
            failure = ScriptError("get_inverse_kin: unable to find an inverse kinematics solution")
            for listener in tuple(self._robot.on_program):
                listener("EXCEPTION", name, failure)

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

    def _handshake_message(self, arguments: Arguments) -> None:
        self._controller.faults.handshake_message = str(arguments.get("text", "controller is busy"))

    # -- dashboard and device

    def _slow_dashboard(self, arguments: Arguments) -> None:
        self._controller.faults.dashboard_delay_s = number(arguments, "s", 1.0)

    def _reboot(self, arguments: Arguments) -> None:
        serial = str(arguments.get("serial", self._robot.identity.serial))
        if not serial.isdigit():
            raise error("ARGUMENT_INVALID", f"serial={serial!r} has other signs than digits")
        self._spawn(self._controller.reboot(number(arguments, "off_s", 2.0), serial))
