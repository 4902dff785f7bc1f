"""The dashboard server: one text line in, one text line out, as the public dashboard manual lists them."""

import asyncio
import logging
from collections.abc import Callable
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from fakes.faults.vocabulary import Link
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
# First versions on the e-series and on CB3 of what not every controller knows; None where it is unknown.
# Serial number and model are answered by every version here, though the controller has them from 5.6 and
# 3.12: a driver identifies the arm by them, and could not be tried with older versions otherwise.
_SINCE: dict[str, tuple[tuple[int, ...] | None, tuple[int, ...] | None]] = {
    "safetystatus": ((5, 4), None),
    "is in remote control": ((5, 6), None),
    "restart safety": ((5, 1), (3, 7)),
    "set operational mode": ((5, 0), None),
    "get operational mode": ((5, 6), None),
    "clear operational mode": ((5, 0), None),
    "setuserrole": (None, (3, 1)),
    "getuserrole": (None, (3, 1)),
    "generate flight report": ((5, 8), (3, 13)),
    "generate support file": ((5, 8), (3, 13)),
    "savelog": ((5, 8), (3, 13)),
}
_USER_ROLES = ("programmer", "operator", "none", "locked", "restricted")
_OPERATIONAL_MODES = ("manual", "automatic")
_NO_SUPPORT_FILE = "Error: the twin writes no support files"
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
        *("isprogramsaved", "getuserrole", "get operational mode", "quit"),
    }
)


def foreign_steps() -> Steps:
    """A program that is not ours: it runs until somebody stops it."""
    while True:
        yield


log = logging.getLogger("cellward.twin.arm")


class Dashboard:
    """The commands; replies are the controller's own words."""

    def __init__(self, robot: "Robot") -> None:
        self._robot = robot
        self._operational_mode = "NONE"
        self._user_role = "NONE"
        self._reports = 0
        self._commands: dict[str, Callable[[], str]] = {
            "play": self._play,
            "stop": self._stop,
            "pause": self._pause,
            "running": lambda: f"Program running: {str(self._playing).lower()}",
            "robotmode": lambda: f"Robotmode: {robot.safety.robot_mode.name}",
            "programstate": self._program_state,
            "get loaded program": self._loaded,
            "isprogramsaved": lambda: f"true {self._program_name}",
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
            "get operational mode": lambda: self._operational_mode,
            "clear operational mode": self._clear_operational_mode,
            "getuserrole": lambda: self._user_role,
            "savelog": _save_log,
            "generate flight report": lambda: self._flight_report(""),
            "shutdown": self._shutdown,
            "quit": lambda: "Disconnected",
        }
        self._with_argument: dict[str, Callable[[str], str]] = {
            "load installation": lambda path: _load_file("installation", path),
            "load": self._load,
            "popup": lambda text: "showing popup",
            "addtolog": _add_to_log,
            "setuserrole": self._set_user_role,
            "set operational mode": self._set_operational_mode,
            "generate flight report": self._flight_report,
            "generate support file": lambda path: _NO_SUPPORT_FILE,
        }

    def answer(self, line: str) -> str:
        """The reply to one command; case does not matter."""
        words = " ".join(line.split()).lower()
        if not self._robot.remote and words not in _READING:
            return LOCAL_REPLY
        if words in self._commands and self._has(words):
            return self._commands[words]()
        for name, command in self._with_argument.items():
            if words.startswith(f"{name} ") and self._has(name):
                return command(line.strip()[len(name) + 1 :].strip())
        return f"could not understand: '{line.strip()[:200]}'"

    def _has(self, name: str) -> bool:
        """Whether the controller's version knows the command ``name``."""
        version = self._robot.identity.version
        first = _SINCE.get(name, ((), ()))[version[0] == 3]
        return first is not None and version >= first

    @property
    def _playing(self) -> bool:
        return self._robot.runtime.state in (RuntimeState.PLAYING, RuntimeState.RESUMING)

    @property
    def _version(self) -> str:
        return ".".join(map(str, self._robot.identity.version))

    def _load(self, path: str) -> str:
        reply = _load_file("program", path)
        if reply.startswith("Loading"):
            self._robot.loaded_program = path
        return reply

    @property
    def _program_name(self) -> str:
        """Of the loaded program, without its folder."""
        return PurePosixPath(self._robot.loaded_program).name or "<unnamed>"

    def _loaded(self) -> str:
        path = self._robot.loaded_program
        return f"Loaded program: {path}" if path else "No program loaded"

    def _program_state(self) -> str:
        states = {RuntimeState.STOPPED: "STOPPED", RuntimeState.STOPPING: "STOPPED"}
        paused = {RuntimeState.PAUSED: "PAUSED", RuntimeState.PAUSING: "PAUSED"}
        word = (states | paused).get(self._robot.runtime.state, "PLAYING")
        return f"{word} {self._program_name}"

    def _play(self) -> str:
        robot = self._robot
        if robot.safety.may_move and robot.runtime.resume(robot.now()):
            return "Starting program"
        if robot.loaded_program and not robot.runtime.active:
            program = Program(robot.loaded_program, foreign_steps(), "foreign")
            if robot.start(program):
                log.warning("%s: the twin shows the program as running, it does nothing", program.name)
                return "Starting program"
        return "Failed to execute: play"

    def _stop(self) -> str:
        """Stopped is also what a program is that has just ended by itself."""
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

    def _set_operational_mode(self, mode: str) -> str:
        if mode.lower() not in _OPERATIONAL_MODES:
            return f"Failed setting operational mode: {mode}"
        self._operational_mode = mode.upper()
        return f"Operational mode {self._operational_mode} is set"

    def _clear_operational_mode(self) -> str:
        before, self._operational_mode = self._operational_mode, "NONE"
        return f"No longer controlling the operational mode. Current operational mode: '{before}'."

    def _set_user_role(self, role: str) -> str:
        if role.lower() not in _USER_ROLES:
            return f"Failed setting user role: {role}"
        self._user_role = role.upper()
        return f"Setting user role: {role}"

    def _flight_report(self, kind: str) -> str:
        """The twin's flight report is a line of its log with the state of the arm."""
        robot = self._robot
        now = robot.instant(robot.now())
        self._reports += 1
        log.info(
            "flight report %d (%s): q %s, TCP %s, robot mode %s, safety mode %s, program state %s",
            *(self._reports, kind or "all", now.q, now.tcp_pose6),
            *(robot.safety.robot_mode.name, robot.safety.mode.name, robot.runtime.state.name),
        )
        return f"Flight Report generated with id: {self._reports}"

    def _shutdown(self) -> str:
        self._robot.power_off()
        return "Shutting down"


def _load_file(kind: str, path: str) -> str:
    """A program (.urp) or an installation; the twin has every file that has the right ending."""
    ending = ".urp" if kind == "program" else ".installation"
    return f"Loading {kind}: {path}" if path.endswith(ending) else f"File not found: {path}"


def _add_to_log(text: str) -> str:
    log.info("log entry of a client: %s", text[:200])
    return "Added log message"


def _save_log() -> str:
    for handler in logging.getLogger().handlers:
        handler.flush()
    return "Log saved to disk"


class DashboardConnection(asyncio.Protocol):
    """One client; replies keep their order even when the dashboard is slow."""

    def __init__(self, dashboard: Dashboard, faults: StreamFaults, open_links: set[Link]) -> None:
        self._dashboard, self._faults, self._open_links = dashboard, faults, open_links
        self._buffer = bytearray()
        self._link: Link | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link = Link.over(transport, self._faults.link)
        self._open_links.add(self._link)
        self._link.send(f"{BANNER}\n".encode())

    def connection_lost(self, exc: Exception | None) -> None:
        if self._link is not None:
            self._open_links.discard(self._link)

    def data_received(self, data: bytes) -> None:
        link = self._link
        if self._faults.link.half_open or link is None:
            return
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).decode("utf-8", "replace")
            del self._buffer[: end + 1]
            self._reply(link, line)
        if len(self._buffer) > LINE_LIMIT:
            link.close()

    def _reply(self, link: Link, line: str) -> None:
        answer = f"{self._dashboard.answer(line)}\n".encode()
        if self._faults.dashboard_delay_s:
            loop = asyncio.get_running_loop()
            loop.call_later(self._faults.dashboard_delay_s, link.send, answer)
        else:
            link.send(answer)
        if line.strip().lower() == "quit":
            link.close()
