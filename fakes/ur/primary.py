"""The primary port: version message, robot state at 10 Hz, program events, and text commands.

Layouts follow the public client interface description; big-endian. Kinematics info carries the arm's
factory-calibrated link parameters (drawing plus deltas) and a check sum for each joint.
"""

import asyncio
import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

from fakes.faults.vocabulary import Link
from fakes.ur.faults import StreamFaults
from fakes.ur.runtime import RuntimeState, ScriptError
from fakes.ur.safety import SafetyMode
from fakes.ur.scripting import ScriptPort, TextAssembler
from fakes.world.arm.kinematics import dh_parameters

if TYPE_CHECKING:
    from fakes.ur.robot import Instant, Robot

PORT = 30001
STATE_PERIOD_S = 0.1
_ROBOT_STATE, _ROBOT_MESSAGE = 16, 20
_TEXT, _VERSION, _KEY, _RUNTIME_EXCEPTION = 0, 3, 7, 10
_SOURCE_ROBOT = -2
_CALIBRATION_LINEARISED = 2
_ROBOT_TYPES = {
    "ur5": 1,
    "ur10": 2,
    "ur3": 3,
    "ur16": 4,
    "ur18": 5,
    "ur8long": 6,
    "ur20": 7,
    "ur30": 8,
    "ur15": 9,
}
_JOINT_RAD_S2 = 40.0  # as a recorded controller tells it; see fakes.world.arm.controller_limits
_EVENTS = {"STARTED", "STOPPED", "PAUSED", "RESUMED"}


def _sub(kind: int, layout: str, *values: float) -> bytes:
    body = struct.pack(">" + layout, *values)
    return struct.pack(">IB", 5 + len(body), kind) + body


def _message(kind: int, stamp: float, body: bytes) -> bytes:
    head = struct.pack(">Qbb", int(stamp * 1e6), _SOURCE_ROBOT, kind)
    return struct.pack(">IB", 5 + len(head) + len(body), _ROBOT_MESSAGE) + head + body


def version_message(robot: "Robot", stamp: float) -> bytes:
    """The first thing a client gets."""
    major, minor, bugfix, build = robot.identity.version
    name, date = b"URControl", b"06-07-2022, 12:00:00"
    body = bytes([len(name)]) + name + struct.pack(">BBII", major, minor, bugfix, build) + date
    return _message(_VERSION, stamp, body)


def key_message(title: str, text: str, stamp: float) -> bytes:
    """A program event; ``title`` is like PROGRAM_XXX_STARTED."""
    body = struct.pack(">iiB", 0, 0, len(title)) + title.encode() + text.encode()
    return _message(_KEY, stamp, body)


def exception_message(failure: ScriptError, stamp: float) -> bytes:
    """An error of a program."""
    place = struct.pack(">ii", failure.line, failure.column)
    return _message(_RUNTIME_EXCEPTION, stamp, place + failure.text.encode())


def text_message(text: str, stamp: float) -> bytes:
    """A line of textmsg()."""
    return _message(_TEXT, stamp, text.encode())


def robot_state(robot: "Robot", now: "Instant") -> bytes:
    """One robot state message with its sub-packages."""
    body = b"".join(
        (
            _robot_mode(robot, now),
            _joints(robot, now),
            _masterboard(robot, now),
            _sub(4, "12d", *now.tcp_pose6, *robot.tool.offset6),
            kinematics_info(robot),
            _configuration(robot),
        )
    )
    return struct.pack(">IB", 5 + len(body), _ROBOT_STATE) + body


def _robot_mode(robot: "Robot", now: "Instant") -> bytes:
    safety, runtime = robot.safety, robot.runtime
    return _sub(
        0,
        "Q7?BBdddB",
        int(now.stamp * 1e6),
        True,
        True,
        safety.powered,
        safety.emergency,
        safety.mode == SafetyMode.PROTECTIVE_STOP,
        runtime.program is not None,
        runtime.state in (RuntimeState.PAUSED, RuntimeState.PAUSING),
        safety.robot_mode,
        robot.modes.mode,
        robot.io.speed_fraction,
        robot.io.speed_fraction,
        1.0,
        0,
    )


def _joints(robot: "Robot", now: "Instant") -> bytes:
    volts = 48.0 if robot.safety.powered else 0.0
    values: list[float] = []
    for q, qd, mode in zip(now.q, now.qd, robot.safety.joint_modes, strict=True):
        values += [q, q, qd, 0.0, volts, 30.0, 30.0, mode]
    return _sub(1, "dddffffB" * 6, *values)


def _masterboard(robot: "Robot", now: "Instant") -> bytes:
    io = robot.io
    return _sub(
        3,
        "IIBBddbbddffffBBBIBBB",
        robot.digital_in(now.t) & 0xFFFFFFFF,
        io.digital_out & 0xFFFFFFFF,
        *(0, 0, 0.0, 0.0),
        *(0, 0, *io.analog_out),
        *(35.0, 48.0, 1.2 if robot.safety.powered else 0.0, 0.0),
        robot.safety.mode,
        robot.safety.mode == SafetyMode.REDUCED,
        *(0, 0, 0, 0, 0),
    )


def kinematics_info(robot: "Robot") -> bytes:
    """Check sums and link parameters as calibrated in the factory: theta, a, d, alpha."""
    theta, d, a, alpha = dh_parameters(robot.identity.model, robot.identity.deltas)
    joints = np.stack([theta, d, a, alpha], axis=1)
    sums = [zlib.crc32(row.astype(">f8").tobytes()) for row in joints]
    return _sub(5, "6I24dI", *sums, *theta, *a, *d, *alpha, _CALIBRATION_LINEARISED)


def _configuration(robot: "Robot") -> bytes:
    model, limits = robot.identity.model, robot.identity.limits
    theta, d, a, alpha = dh_parameters(model)
    return _sub(
        6,
        "12d12d5d24d4i",
        *limits.ranges().ravel(),
        *(value for speed in limits.speeds(model) for value in (speed, _JOINT_RAD_S2)),
        *(np.deg2rad(60.0), np.deg2rad(80.0), 0.25, 1.2, 0.25),
        *(*theta, *a, *d, *alpha),
        *(0, 0, _ROBOT_TYPES.get(model.removesuffix("e"), 0), int(model.endswith("e"))),
    )


class PrimaryServer:
    """Port 30001 of one controller."""

    def __init__(self, robot: "Robot", scripts: ScriptPort, faults: StreamFaults) -> None:
        self.robot, self.scripts, self.faults = robot, scripts, faults
        self.links: set[Link] = set()
        self._state_due = 0.0
        robot.on_program.append(self._program_event)
        robot.on_message.append(lambda text: self.send(text_message(text, self._stamp)))

    @property
    def _stamp(self) -> float:
        return self.robot.now() - self.robot.boot_time

    def publish(self, now: "Instant") -> None:
        """Send the robot state when its turn has come."""
        if now.t >= self._state_due:
            self._state_due = now.t + STATE_PERIOD_S
            if self.links and not self.faults.silent:
                self.send(robot_state(self.robot, now))

    def send(self, data: bytes) -> None:
        """To every client."""
        for link in tuple(self.links):
            link.send(data)

    def _program_event(self, event: str, name: str, failure: ScriptError | None) -> None:
        if failure is not None:
            self.send(exception_message(failure, self._stamp))
        if event in _EVENTS:
            self.send(key_message(f"PROGRAM_XXX_{event}", name, self._stamp))


class TextConnection(asyncio.Protocol):
    """A client of a text port; only one of the primary port is greeted and gets messages."""

    def __init__(self, server: PrimaryServer, open_links: set[Link], greeting: bool) -> None:
        self._server, self._open_links, self._greeting = server, open_links, greeting
        self._assembler = TextAssembler()
        self._link: Link | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link = Link.over(transport, self._server.faults.link)
        self._open_links.add(self._link)
        if self._greeting:
            robot = self._server.robot
            self._link.send(version_message(robot, robot.now() - robot.boot_time))

    def connection_lost(self, exc: Exception | None) -> None:
        if self._link is not None:
            self._open_links.discard(self._link)

    def data_received(self, data: bytes) -> None:
        if self._server.faults.link.half_open or self._link is None:
            return
        try:
            for text in self._assembler.feed(data):
                self._server.scripts.take(text)
        except OverflowError:
            self._link.close()
