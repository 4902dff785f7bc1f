"""The vocabulary of faults, where they are injected, and a TCP link that can be made to misbehave.

One vocabulary serves scenario files, the twin's command line and tests. A device says which of them it
can show (:class:`Faulty`), and the :class:`Switchboard` finds the device by name.
"""

import asyncio
import socket
import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

from cell.errors import error

MAX_ARGUMENT = 1e6
MOST_DELAYED_BYTES = 16 << 20


class Fault(StrEnum):
    """Everything that can go wrong in the twin."""

    # transport
    REFUSE = "refuse"  # new connections are refused, open ones are cut
    DROP = "drop"  # connections end with FIN
    RESET = "reset"  # connections end with RST
    HALF_OPEN = "half-open"  # connections stay open, nothing is read or written
    SILENCE = "silence"  # the stream stops, requests are still answered
    DELAY = "delay"  # everything that is sent arrives late
    SPLIT = "split"  # packages arrive in pieces
    JUNK = "junk"  # bytes that are no package
    # values
    FREEZE = "freeze"  # the stream repeats its last package
    DUPLICATE = "duplicate"  # each package comes twice
    GAP = "gap"  # packages are left out
    CLOCK_JUMP = "clock-jump"  # the source's clock jumps
    WRAP = "wrap"  # a counter wraps
    STUCK = "stuck"  # an input keeps its level
    BOUNCE = "bounce"  # an input bounces at each edge
    # belt and CAN
    SLIP = "slip"  # the encoder's wheel gets ahead of the belt
    UNPLUG = "unplug"  # the encoder's connector is pulled, its bus and adapters stay
    BUS_OFF = "bus-off"  # the CAN controller of the adapter has given up
    NODE_STOP = "node-stop"  # another master stops the node
    SECOND_SENDER = "second-sender"  # another node sends positions with the same identifier
    ALARM = "alarm"  # the device reports a fault of its own
    BELT_STOP = "belt-stop"  # the belt stands
    BELT_REVERSE = "belt-reverse"  # the belt runs the other way
    # camera
    LOST_BOARD = "lost-board"  # the target is not in the view
    DARK = "dark"  # too little light
    # arm
    PROTECTIVE_STOP = "protective-stop"
    EMERGENCY_STOP = "emergency-stop"
    SAFEGUARD_STOP = "safeguard-stop"
    REDUCED_MODE = "reduced-mode"  # the safety configuration reduces speeds and forces
    LOCAL_MODE = "local-mode"
    FOREIGN_PROGRAM = "foreign-program"
    REGISTER_IN_USE = "register-in-use"
    NOT_FOUND = "not-found"
    HANDSHAKE_MESSAGE = "handshake-message"
    SCRIPT_DEATH = "script-death"
    LATE_FIRST_PACKAGE = "late-first-package"
    SLOW_DASHBOARD = "slow-dashboard"
    SPEED_SLIDER = "speed-slider"  # somebody slides the pendant's speed to a fraction of full speed
    # tracker
    BEAM_BREAK = "beam-break"  # something stands between it and the reflectors
    OUT_OF_VIEW = "out-of-view"  # reflectors face somewhere else
    STAND_MOVED = "stand-moved"  # somebody pushed its stand
    WRONG_CONSTANT = "wrong-constant"  # somebody set another reflector constant on its panel
    VIBRATION = "vibration"  # the point is never at rest
    DOUBTFUL = "doubtful"  # it does not vouch for its points
    RETURN_CODE = "return-code"  # a command ends with this code
    # observed arm
    UNASKED_MOVE = "unasked-move"  # somebody jogs it while it should stand
    SKIP_POSE = "skip-pose"  # its program says that it is at the next pose and has not gone there
    WRONG_ORDER = "wrong-order"  # at the next request its program goes where the last one was
    # whole device
    REBOOT = "reboot"  # the device restarts, on request with another identity
    KILL = "kill"  # the process ends without a word


class Faulty(Protocol):
    """A device that can show faults."""

    def offers(self) -> frozenset[Fault]:
        """The faults that make sense for this device."""
        ...

    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for an argument it does not take."""
        ...

    def clear(self) -> None:
        """End every fault that lasts."""
        ...


class Switchboard:
    """The devices of a twin by name."""

    def __init__(self) -> None:
        self.devices: dict[str, Faulty] = {}

    def inject(self, device: str, name: str, arguments: Mapping[str, Any]) -> None:
        """Begin the fault called ``name`` on ``device``; ``clear`` ends the lasting ones."""
        target = self.devices.get(device)
        if target is None:
            raise error("ARGUMENT_INVALID", f"no device {device!r}; there are {', '.join(self.devices)}")
        if name == "clear":
            target.clear()
            return
        target.inject(parse_fault(name, target.offers(), device), arguments)


def parse_fault(name: str, offered: frozenset[Fault], device: str) -> Fault:
    """The fault called ``name`` if ``device`` offers it, else ``ARGUMENT_INVALID`` with the list."""
    known = sorted(f.value for f in offered)
    if name not in known:
        raise error("ARGUMENT_INVALID", f"{device} has no fault {name!r}; it has {', '.join(known)}, clear")
    return Fault(name)


def number(arguments: Mapping[str, Any], key: str, default: float, low: float = 0.0) -> float:
    """A numeric argument in ``low..1e6``, as given on a command line or in TOML."""
    try:
        value = float(arguments.get(key, default))
    except (TypeError, ValueError):
        raise error("ARGUMENT_INVALID", f"{key}={arguments[key]!r} is not a number") from None
    if not low <= value <= MAX_ARGUMENT:
        raise error("ARGUMENT_INVALID", f"{key}={value:g} is not between {low:g} and {MAX_ARGUMENT:g}")
    return value


@dataclass
class LinkFaults:
    """How the TCP links of one server misbehave."""

    half_open: bool = False
    delay_s: float = 0.0
    split: bool = False


@dataclass(eq=False)
class Link:
    """The sending side of one connection or serial line: ordered, bounded, and able to delay and to split.

    A peer that does not read is cut off when ``limit`` bytes wait for it, besides what is delayed on purpose.
    """

    transport: asyncio.Transport
    faults: LinkFaults
    limit: int = 256 * 1024
    _waiting: deque[tuple[float, bytes]] = field(default_factory=deque)
    _waiting_bytes: int = 0

    @classmethod
    def over(cls, transport: asyncio.BaseTransport, faults: LinkFaults) -> "Link":
        """The link of a connection that asyncio has just made."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError(f"{transport!r} cannot be written to")
        return cls(transport, faults)

    def __post_init__(self) -> None:
        sock = self.transport.get_extra_info("socket")
        if sock is None:  # a serial line
            return
        if sock.family != socket.AF_UNIX:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self.limit)

    def send(self, data: bytes) -> None:
        """Queue ``data``; silently nothing once the link is closing or half-open."""
        if self.transport.is_closing() or self.faults.half_open:
            return
        if self.faults.split and len(data) > 1:
            middle = len(data) // 2
            self._later(self.faults.delay_s, data[:middle])
            self._later(self.faults.delay_s + 0.0005, data[middle:])
        elif self.faults.delay_s or self._waiting:
            self._later(self.faults.delay_s, data)
        else:
            self.transport.write(data)
        if self.transport.get_write_buffer_size() > self.limit or self._waiting_bytes > MOST_DELAYED_BYTES:
            self.transport.abort()

    def close(self, reset: bool = False) -> None:
        """End the connection: FIN, or RST with ``reset``."""
        if reset:
            linger = struct.pack("ii", 1, 0)
            self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            self.transport.abort()
        else:
            self.transport.close()

    def _later(self, delay: float, data: bytes) -> None:
        loop = asyncio.get_running_loop()
        # Never before what already waits: TCP keeps its order.
        due = max(loop.time() + delay, self._waiting[-1][0] if self._waiting else 0.0)
        self._waiting.append((due, data))
        self._waiting_bytes += len(data)
        loop.call_at(due, self._pump)

    def _pump(self) -> None:
        now = asyncio.get_running_loop().time()
        while self._waiting and self._waiting[0][0] <= now + 1e-6:
            _, data = self._waiting.popleft()
            self._waiting_bytes -= len(data)
            if not self.transport.is_closing():
                self.transport.write(data)
