"""The motion child: ur-rtde's control interface in a process of its own.

``python -m drivers.ur.motion_child FD PARENT_PID`` talks length-prefixed JSON on the socket ``FD``. It exists
because the native client may hang, abort or crash; whatever it does, only this process is lost, and the
controller's watchdog stops the arm. Rules:

- one command at a time, each with its own deadline; past it the process exits;
- moves are asynchronous, so that a stop is always received;
- the watchdog is set after every upload, and kicked only while the daemon's beat is younger than 100 ms;
- a closed pipe, a dead parent or a dropped RTDE link ends the process: the client must never reconnect.
"""

import ctypes
import os
import select
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar, Protocol

from cell.priority import SETPOINTS, stay_in_real_time
from drivers.ur.following import Follower, Piece
from drivers.ur.framing import Message, Unframer, encode
from drivers.ur.pace import Pace

BEAT_LIMIT_S = 0.1
KICK_PERIOD_S = 0.02
SERVO_PERIOD_S = 0.002  # of an e-Series controller; the daemon tells that of an older one
SERVO_CALL_LIMIT_S = 0.3
TICK_S, PAUSED_S = 0.01, 0.1

EXIT_PIPE_CLOSED = 0
EXIT_DEADLINE = 70
EXIT_LINK_LOST = 71
EXIT_BAD_MESSAGE = 72

_PR_SET_PDEATHSIG = 1


class Control(Protocol):
    """The part of ur-rtde's RTDEControlInterface that is used."""

    def isConnected(self) -> bool: ...
    def isProgramRunning(self) -> bool: ...
    def setWatchdog(self, min_frequency: float) -> bool: ...
    def kickWatchdog(self) -> bool: ...
    def setTcp(self, offset: list[float]) -> bool: ...
    def getTCPOffset(self) -> list[float]: ...
    def setPayload(self, mass: float, cog: list[float]) -> bool: ...
    def moveJ(self, q: list[float], speed: float, acceleration: float, asynchronous: bool) -> bool: ...
    def moveL(self, pose: list[float], speed: float, acceleration: float, asynchronous: bool) -> bool: ...
    def stopL(self, a: float, asynchronous: bool) -> None: ...
    def servoJ(self, q: list[float], v: float, a: float, t: float, lookahead: float, gain: float) -> bool: ...
    def servoStop(self, a: float) -> bool: ...
    def stopScript(self) -> None: ...


class CallLimit(threading.Thread):
    """Ends the process when the call under way overruns its deadline; a native call cannot be cancelled."""

    def __init__(self) -> None:
        super().__init__(name="call limit", daemon=True)
        self._until: float | None = None
        self._what = ""

    def run(self) -> None:
        before = time.monotonic()
        while True:
            time.sleep(TICK_S)
            now = time.monotonic()
            if self._until is not None:
                # A process that stood still is late itself; that time is not the call's.
                self._until += max(now - before - PAUSED_S, 0.0)
                if now > self._until:
                    os.write(2, f"the call '{self._what}' overran its deadline\n".encode())
                    os._exit(EXIT_DEADLINE)
            before = now

    @contextmanager
    def within(self, seconds: float, what: str) -> Iterator[None]:
        """Run a native call with a deadline."""
        self._what, self._until = what, time.monotonic() + seconds
        try:
            yield
        finally:
            self._until = None


class MotionChild:
    """Serves the daemon's commands until its pipe closes."""

    def __init__(
        self,
        pipe: socket.socket,
        connect: Callable[[str], Control],
        limit: CallLimit,
        leave: Callable[[int], None] = os._exit,
    ) -> None:
        self._pipe, self._connect, self._limit, self._leave = pipe, connect, limit, leave
        self._unframer = Unframer()
        self._inbox: deque[Message] = deque()
        self._control: Control | None = None
        self._beat = -1e9
        self._kicking = False
        self._withheld = False
        self._next_kick = 0.0
        self._told = -1e9  # the latest kick that the daemon was told of
        self._follower: Follower | None = None
        self._servo = (0.0, 0.0, 0.0)  # look-ahead, gain, deceleration
        self._servoing = self._broken_off = False
        self._pace = Pace(SERVO_PERIOD_S)

    def run(self) -> None:
        """The loop: read from the daemon, serve one command, keep the watchdog or the set-points going."""
        while True:
            due = self._pace.due if self._follower is not None else self._next_kick
            self._hear(min(max(due - time.monotonic(), 0.0), KICK_PERIOD_S))
            if self._inbox:
                self._serve(self._inbox.popleft())
            self._keep_alive()

    def _hear(self, timeout: float) -> None:
        if self._inbox:
            timeout = 0.0
        readable, _, _ = select.select([self._pipe], [], [], timeout)
        if not readable:
            return
        try:
            data = self._pipe.recv(65536)
        except ConnectionError:
            data = b""
        if not data:
            self._leave(EXIT_PIPE_CLOSED)
        for message in self._unframer.feed(data):
            if "beat" in message:
                self._beat = float(message["beat"])
            else:
                self._inbox.append(message)

    def _serve(self, message: Message) -> None:
        command = MotionChild.COMMANDS.get(message["do"])
        if command is None:
            self._leave(EXIT_BAD_MESSAGE)
            return
        arguments = message.get("with", {})
        try:
            with self._limit.within(message["deadline_s"], message["do"]):
                reply: Message = {"ok": True, "value": command(self, **arguments)}
        except (RuntimeError, ValueError, IndexError) as exc:  # what the native client raises
            reply = {"ok": False, "text": f"{type(exc).__name__}: {exc}"}
        if "id" in message:
            self._tell({"id": message["id"], **reply})
        if message["do"] == "end":
            self._leave(EXIT_PIPE_CLOSED)

    def _tell(self, message: Message) -> None:
        try:
            self._pipe.sendall(encode(message))
        except OSError:
            self._leave(EXIT_PIPE_CLOSED)

    def _keep_alive(self) -> None:
        if self._control is None:
            self._next_kick = time.monotonic() + KICK_PERIOD_S
            return
        if not self._control.isConnected():
            # Left alone, the client would reconnect and upload its script again.
            self._leave(EXIT_LINK_LOST)
        if self._follower is not None:
            self._follow(self._control, self._follower)
        elif time.monotonic() >= self._next_kick:
            self._kick(self._control)

    def _kick(self, control: Control) -> None:
        self._next_kick = time.monotonic() + KICK_PERIOD_S
        self._hear(0.0)  # beats that came during a long call count
        if not self._kicking:
            return
        age = time.monotonic() - self._beat
        if age > BEAT_LIMIT_S:
            if not self._withheld:
                self._withheld = True
                self._tell({"event": "withheld", "age_s": age})
            return
        self._tell_kick()
        with self._limit.within(SERVO_CALL_LIMIT_S, "kick"):
            # False means that the script is gone; kicking on would only fill the log.
            self._kicking = control.kickWatchdog()
        if self._withheld and self._kicking:
            self._withheld = False
            self._tell({"event": "kicking"})

    def _tell_kick(self) -> None:
        """Before the native call, which may wait and never return: from here on the controller has a kick."""
        self._told = time.monotonic()
        self._tell({"event": "kicked", "at": self._told})

    def _follow(self, control: Control, follower: Follower) -> None:
        now = time.monotonic()
        if now < self._pace.due:
            return
        instant = self._pace.take(now)
        q = follower.setpoint(instant, self._beat)
        if q is None:
            if now >= self._next_kick:
                self._kick(control)
        elif not self._send_setpoint(control, q):
            self._end_following("refused")
            return
        else:
            self._servoing = True
        if (why := follower.broken_off) is not None and not self._broken_off:
            self._broken_off = True
            self._tell({"event": "broken off", "why": why.value})
        end = follower.ended(instant, self._beat)
        if end is not None:
            if self._servoing:
                with self._limit.within(1.0, "servoStop"):
                    control.servoStop(self._servo[2])
            self._end_following(end.value)

    def _send_setpoint(self, control: Control, q: list[float]) -> bool:
        lookahead, gain, _ = self._servo
        if time.monotonic() - self._told >= KICK_PERIOD_S:
            self._tell_kick()  # a set-point is a kick; one in ten is told
        with self._limit.within(SERVO_CALL_LIMIT_S, "servoJ"):
            return control.servoJ(q, 0.0, 0.0, self._pace.period_s, lookahead, gain)

    def _end_following(self, end: str) -> None:
        self._follower = None
        self._next_kick = 0.0
        self._tell({"event": "followed", "end": end})

    # Commands. Each returns what the reply carries.

    def _open(self, host: str, watchdog_hz: float, servo_period_s: float = SERVO_PERIOD_S) -> bool:
        self._pace = Pace(servo_period_s)
        self._control = self._connect(host)
        if not self._control.isProgramRunning():
            raise RuntimeError("the control script did not start")
        if not self._control.setWatchdog(watchdog_hz):
            raise RuntimeError("setWatchdog was refused")
        self._kicking, self._next_kick = True, 0.0
        self._tell_kick()
        return True

    def _tool(self, tcp: list[float], mass: float, cog: list[float]) -> list[float]:
        control = self._live()
        if not control.setTcp(_six(tcp)) or not control.setPayload(mass, _three(cog)):
            raise RuntimeError("setTcp or setPayload was refused")
        return list(control.getTCPOffset())

    def _move_joints(self, q: list[float], speed: float, accel: float) -> bool:
        return self._idle().moveJ(_six(q), speed, accel, asynchronous=True)

    def _move_linear(self, pose: list[float], speed: float, accel: float) -> bool:
        return self._idle().moveL(_six(pose), speed, accel, asynchronous=True)

    def _stop(self, decel: float) -> bool:
        if self._follower is not None:
            self._follower.stop()
        else:
            self._live().stopL(decel, asynchronous=True)
        return True

    def _begin_following(
        self, horizon_s: float, ramp: float, lookahead: float, gain: float, decel: float
    ) -> bool:
        self._idle()
        # Servoing lags by the look-ahead time, so the last set-point is held for longer than that: after four
        # of them a low-pass of that time has left 2 % of the way.
        self._follower = Follower(min(horizon_s, BEAT_LIMIT_S), ramp, 4.0 * lookahead + 0.04, gap_s=lookahead)
        self._servo = (lookahead, gain, decel)
        self._servoing = self._broken_off = False
        self._pace.begin(time.monotonic())
        return True

    def _piece(
        self, t0: float, t1: float, coefficients: list[list[float]], cycle: float | None = None
    ) -> bool:
        if cycle is not None:
            self._pace.keep_to(cycle)
        if self._follower is not None:
            self._follower.add(Piece(t0, t1, [_six(row) for row in coefficients]))
        return self._follower is not None

    def _finish(self) -> bool:
        if self._follower is not None:
            self._follower.finish()
        return True

    def _end(self) -> bool:
        if self._control is not None:
            self._control.stopScript()
        return True

    def _live(self) -> Control:
        if self._control is None:
            raise RuntimeError("the control interface is not open")
        return self._control

    def _idle(self) -> Control:
        if self._follower is not None:
            raise RuntimeError("a trajectory is being followed")
        return self._live()

    COMMANDS: ClassVar[dict[str, Callable[..., Any]]] = {
        "open": _open,
        "tool": _tool,
        "move_joints": _move_joints,
        "move_linear": _move_linear,
        "stop": _stop,
        "follow": _begin_following,
        "piece": _piece,
        "finish": _finish,
        "end": _end,
    }


def _six(values: list[float]) -> list[float]:
    """The client does not check lengths; a short vector would be a malformed package and a long hang."""
    if len(values) != 6:
        raise ValueError(f"6 numbers needed, got {len(values)}")
    return [float(v) for v in values]


def _three(values: list[float]) -> list[float]:
    if len(values) != 3:
        raise ValueError(f"3 numbers needed, got {len(values)}")
    return [float(v) for v in values]


def connect_control(host: str) -> Control:
    """Upload the control script. Holds the interpreter lock and may hang: the daemon's deadline ends it."""
    from rtde_control import RTDEControlInterface

    control: Control = RTDEControlInterface(host)
    return control


def die_with_parent(parent: int) -> None:
    """Ask the kernel for SIGKILL when the parent dies; exit if it is gone already."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:
        os._exit(EXIT_PIPE_CLOSED)


def main(arguments: list[str]) -> None:
    """Entry point of the process."""
    fd, parent = (int(a) for a in arguments)
    # Ctrl-C and a service stop reach the whole group; the daemon handles them: it stops the arm through us
    # and then ends us.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    die_with_parent(parent)
    stay_in_real_time(SETPOINTS)  # before the native client starts its threads
    limit = CallLimit()
    limit.start()
    MotionChild(socket.socket(fileno=fd), connect_control, limit).run()


if __name__ == "__main__":
    main(sys.argv[1:])
