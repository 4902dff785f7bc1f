"""What arrives on the text ports: whole programs, single lines, and the controller's own commands."""

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from fakes.ur.control_script import ControlProgram, recognise
from fakes.ur.interpreter import Interpreter, secondary_steps
from fakes.ur.runtime import Program, ScriptError
from fakes.ur.urscript import NotInSubsetError, ParsedProgram, read_program

if TYPE_CHECKING:
    from fakes.ur.robot import Robot

TEXT_LIMIT = 1 << 20
_BLOCK = re.compile(r"^(def|sec)\s")
# The program of UR's driver says so in its messages, and opens a socket of this name back to the driver.
_EXTERNAL_CONTROL = re.compile(r'"ExternalControl: |"reverse_socket"')


class TextAssembler:
    """Cuts a byte stream into programs: from ``def``/``sec`` to ``end`` in the first column, or one line."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._block: list[str] = []

    def feed(self, data: bytes) -> Iterator[str]:
        """Yield every program that ``data`` completes; ``OverflowError`` beyond one megabyte."""
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).decode("utf-8", "replace").rstrip("\r")
            del self._buffer[: end + 1]
            yield from self._line(line)
        if len(self._buffer) + sum(map(len, self._block)) > TEXT_LIMIT:
            raise OverflowError("a program without an end")

    def _line(self, line: str) -> Iterator[str]:
        if self._block:
            self._block.append(line)
            if line.rstrip() == "end":
                yield "\n".join(self._block) + "\n"
                self._block = []
        elif _BLOCK.match(line):
            self._block = [line]
        elif line.strip():
            yield line + "\n"


class ScriptPort:
    """Starts what was uploaded. In local control the text ports only read, so nothing happens."""

    def __init__(self, robot: "Robot") -> None:
        self._robot = robot
        self._commands: dict[str, Callable[[], object]] = {
            "power on": lambda: robot.safety.power_on(robot.now()),
            "power off": robot.power_off,
            "set robotmode run": lambda: robot.safety.brake_release(robot.now()),
            "set unlock protective stop": lambda: robot.safety.unlock_protective_stop(robot.now()),
            "stop program": lambda: robot.runtime.stop(robot.now()),
            "pause program": lambda: robot.runtime.pause(robot.now()),
            "resume program": lambda: robot.runtime.resume(robot.now()),
        }

    def take(self, text: str) -> None:
        """One complete program or command."""
        if not self._robot.remote:
            return
        command = self._commands.get(text.strip().lower())
        if command is not None:
            command()
            return
        try:
            control = recognise(text)
        except NotInSubsetError as exc:
            why = f"the twin does not interpret this program: injected path: {exc.why}"
            self._refuse("rtde_control", ScriptError(why, exc.line))
            return
        if control is not None:
            steps = ControlProgram(self._robot, control).steps()
            self._robot.start(Program("rtde_control", steps, "control"))
            return
        if _EXTERNAL_CONTROL.search(text):
            self._refuse(
                "external_control",
                ScriptError("the twin does not emulate UR's External Control program; use RTDE with it"),
            )
            return
        self._take_source(read_program(text))

    def _take_source(self, source: ParsedProgram) -> None:
        failure = self._unknown(source)
        if failure is not None:
            self._refuse(source.name, failure, source.secondary)
        elif source.secondary:
            self._robot.start_secondary(secondary_steps(self._robot, source))
        else:
            steps = Interpreter(self._robot).run(source.statements)
            self._robot.start(Program(source.name, steps, "script"))

    def _unknown(self, source: ParsedProgram) -> ScriptError | None:
        """What keeps a program from being run, in the controller's words where it has some."""
        if source.unknown is not None:
            line, why = source.unknown
            return ScriptError(f"the twin does not interpret this program: {why}", line)
        unknown = Interpreter(self._robot).unknown(source.statements)
        if unknown is None:
            return None
        line, column, name = unknown
        self._robot.say(f"the twin does not know {name}, which a controller may")
        return ScriptError(f"compile_error_name_not_found:{name}:", line, column)

    def _refuse(self, name: str, failure: ScriptError, secondary: bool = False) -> None:
        """The program is not started; like any other that comes, it ends the one that runs."""
        if not secondary:
            self._robot.runtime.stop(self._robot.now())
        self._robot.report(name, failure)
