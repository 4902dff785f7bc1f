"""The dashboard server: one text line in, one text line out, as the public dashboard manual lists them."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from fakes.faults import Link
from fakes.ur.faults import StreamFaults
from fakes.ur.runtime import Program, RuntimeState, Steps
from fakes.ur.safety import SafetyMode

if TYPE_CHECKING:
    from fakes.ur.robot import Robot

PORT = 29999
BANNER = "Connected: Universal Robots Dashboard Server"
LINE_LIMIT = 4096
LOCAL_REPLY = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode "
    "and reconnect to port 29999"
)
_UNLOCK_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop "
    "before unlocking"
)
_READING = frozenset(
    {
        *(
            "running",
            "robotmode",
            "programstate",
            "polyscopeversion",
            "version",
            "safetymode",
            "safetystatus",
        ),
        *("get loaded program", "get serial number", "get robot model", "is in remote control"),
        *("isprogramsaved", "version", "quit"),
    }
)


def foreign_steps() -> Steps:
    """A program that is not ours: it runs until somebody stops it."""
    while True:
        yield


class Dashboard:
    """The commands; replies are the controller's own words."""

    def __init__(self, robot: "Robot") -> None:
        self._robot = robot
        self._commands: dict[str, Callable[[], str]] = {
            "play": self._play,
            "stop": self._stop,
            "pause": self._pause,
            "running": lambda: f"Program running: {str(self._playing).lower()}",
            "robotmode": lambda: f"Robotmode: {robot.safety.robot_mode.name}",
            "programstate": self._program_state,
            "get loaded program": self._loaded,
            "isprogramsaved": lambda: f"true {robot.loaded_program or '<unnamed>'}",
            "polyscopeversion": lambda: f"URSoftware {self._version} (Jul 06 2022)",
            "version": lambda: self._version,
            "get serial number": lambda: robot.identity.serial,
            "get robot model": lambda: robot.identity.model.upper().removesuffix("E"),
            "is in remote control": lambda: str(robot.remote).lower(),
            "safetymode": lambda: f"Safetymode: {robot.safety.mode.name}",
            "safetystatus": lambda: f"Safetystatus: {robot.safety.mode.name}",
            "power on": self._power_on,
            "power off": self._power_off,
            "brake release": self._brake_release,
            "unlock protective stop": self._unlock,
            "restart safety": self._restart_safety,
            "close popup": lambda: "closing popup",
            "close safety popup": lambda: "closing safety popup",
            "shutdown": self._shutdown,
            "quit": lambda: "Disconnected",
        }
        self._with_argument: dict[str, Callable[[str], str]] = {
            "load": self._load,
            "popup": lambda text: "showing popup",
            "addtolog": lambda text: "Added log message",
            "setuserrole": lambda role: f"Setting user role: {role}",
            "set operational mode": lambda mode: f"Operational mode '{mode}' is set",
        }

    def answer(self, line: str) -> str:
        """The reply to one command; case does not matter."""
        words = line.strip().lower()
        if not self._robot.remote and words not in _READING:
            return LOCAL_REPLY
        if words in self._commands:
            return self._commands[words]()
        for name, command in self._with_argument.items():
            if words.startswith(f"{name} "):
                return command(line.strip()[len(name) + 1 :])
        return f"could not understand: '{line.strip()[:200]}'"

    @property
    def _playing(self) -> bool:
        return self._robot.runtime.state in (RuntimeState.PLAYING, RuntimeState.RESUMING)

    @property
    def _version(self) -> str:
        return ".".join(map(str, self._robot.identity.version))

    def _load(self, path: str) -> str:
        if not path.endswith(".urp"):
            return f"File not found: {path}"
        self._robot.loaded_program = path
        return f"Loading program: {path}"

    def _loaded(self) -> str:
        path = self._robot.loaded_program
        return f"Loaded program: {path}" if path else "No program loaded"

    def _program_state(self) -> str:
        states = {RuntimeState.STOPPED: "STOPPED", RuntimeState.STOPPING: "STOPPED"}
        paused = {RuntimeState.PAUSED: "PAUSED", RuntimeState.PAUSING: "PAUSED"}
        word = (states | paused).get(self._robot.runtime.state, "PLAYING")
        return f"{word} {self._robot.loaded_program or '<unnamed>'}"

    def _play(self) -> str:
        robot = self._robot
        if robot.safety.may_move and robot.runtime.resume(robot.now()):
            return "Starting program"
        if robot.loaded_program and not robot.runtime.active:
            program = Program(robot.loaded_program, foreign_steps(), "foreign")
            if robot.start(program):
                return "Starting program"
        return "Failed to execute: play"

    def _stop(self) -> str:
        if not self._robot.runtime.active:
            return "Failed to execute: stop"
        self._robot.runtime.stop(self._robot.now())
        return "Stopped"

    def _pause(self) -> str:
        done = self._robot.runtime.pause(self._robot.now())
        return "Pausing program" if done else "Failed to execute: pause"

    def _power_on(self) -> str:
        self._robot.safety.power_on(self._robot.now())
        return "Powering on"

    def _power_off(self) -> str:
        self._robot.power_off()
        return "Powering off"

    def _brake_release(self) -> str:
        self._robot.safety.brake_release(self._robot.now())
        return "Brake releasing"

    def _unlock(self) -> str:
        released = self._robot.safety.unlock_protective_stop(self._robot.now())
        return "Protective stop releasing" if released else _UNLOCK_EARLY

    def _restart_safety(self) -> str:
        self._robot.power_off()
        self._robot.safety.release(
            SafetyMode.VIOLATION,
            SafetyMode.FAULT,
            SafetyMode.ROBOT_EMERGENCY_STOP,
            SafetyMode.SYSTEM_EMERGENCY_STOP,
        )
        return "Restarting safety"

    def _shutdown(self) -> str:
        self._robot.power_off()
        return "Shutting down"


class DashboardConnection(asyncio.Protocol):
    """One client; replies keep their order even when the dashboard is slow."""

    def __init__(self, dashboard: Dashboard, faults: StreamFaults, open_links: set[Link]) -> None:
        self._dashboard, self._faults, self._open_links = dashboard, faults, open_links
        self._buffer = bytearray()
        self._link: Link | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._link = Link(transport, self._faults.link)
        self._open_links.add(self._link)
        self._link.send(f"{BANNER}\n".encode())

    def connection_lost(self, exc: Exception | None) -> None:
        if self._link is not None:
            self._open_links.discard(self._link)

    def data_received(self, data: bytes) -> None:
        if self._faults.link.half_open or self._link is None:
            return
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).decode("utf-8", "replace")
            del self._buffer[: end + 1]
            self._reply(line)
        if len(self._buffer) > LINE_LIMIT:
            self._link.close()

    def _reply(self, line: str) -> None:
        assert self._link is not None
        answer = f"{self._dashboard.answer(line)}\n".encode()
        if self._faults.dashboard_delay_s:
            loop = asyncio.get_running_loop()
            loop.call_later(self._faults.dashboard_delay_s, self._link.send, answer)
        else:
            self._link.send(answer)
        if line.strip().lower() == "quit":
            self._link.close()
