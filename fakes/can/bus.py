"""One CAN bus: whoever is on it hears every frame but its own."""

from collections.abc import Callable
from dataclasses import dataclass, field

ERROR_BUS_OFF = 0x40  # class of an error frame, as Linux numbers them


@dataclass(frozen=True, slots=True)
class Frame:
    """A data or remote frame with its identifier of 11 or 29 bits."""

    id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False


Receive = Callable[[Frame, float], None]  # the frame, and when it was on the bus


@dataclass
class BusFaults:
    """How frames get lost or doubled on the way."""

    off: bool = False
    duplicate: bool = False
    lose: dict[int, int] = field(default_factory=dict)  # by identifier: so many of the next ones


class CanBus:
    """Frames need no time. ``bit_rate`` is that of the wires: an adapter set to another hears nothing."""

    def __init__(self, bit_rate: int = 250_000) -> None:
        self.bit_rate = bit_rate
        self.faults = BusFaults()
        self.off_listeners: list[Callable[[], None]] = []
        self.sent: dict[int, int] = {}  # frames by identifier, lost ones included
        self._ports: list[Port] = []

    def join(self, receive: Receive) -> "Port":
        """Hear every frame that others send."""
        port = Port(self, receive)
        self._ports.append(port)
        return port

    def leave(self, port: "Port") -> None:
        """Hear nothing more."""
        self._ports.remove(port)

    def switch_off(self, off: bool) -> None:
        """The controllers of all adapters give up, or are started again."""
        self.faults.off = off
        if off:
            for listener in tuple(self.off_listeners):
                listener()

    def carry(self, frame: Frame, t: float, sender: "Port") -> None:
        """Hand a frame to everybody else."""
        self.sent[frame.id] = self.sent.get(frame.id, 0) + 1
        if self.faults.off:
            return
        if (left := self.faults.lose.get(frame.id, 0)) > 0:
            self.faults.lose[frame.id] = left - 1
            return
        for _ in range(2 if self.faults.duplicate else 1):
            for port in tuple(self._ports):
                if port is not sender:
                    port.receive(frame, t)


@dataclass(frozen=True, eq=False)
class Port:
    """Where one member is connected."""

    bus: CanBus
    receive: Receive

    def send(self, frame: Frame, t: float) -> None:
        """Put a frame on the bus at ``t`` (s of the twin's clock)."""
        self.bus.carry(frame, t, self)

    def leave(self) -> None:
        """Disconnect."""
        self.bus.leave(self)
