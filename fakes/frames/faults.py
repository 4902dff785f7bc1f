"""What can go wrong with the twin's camera, on both ends of the pipe to the frame server."""

import os
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fakes.faults.vocabulary import Fault, number
from fakes.world.world import Message

_OFFERED = frozenset(
    {
        Fault.REFUSE,
        Fault.DROP,
        Fault.SILENCE,
        Fault.DELAY,
        Fault.JUNK,
        Fault.FREEZE,
        Fault.CLOCK_JUMP,
        Fault.LOST_BOARD,
        Fault.DARK,
        Fault.REBOOT,
        Fault.KILL,
    }
)


class CameraFaults:
    """The camera on the twin's switchboard: checks a fault and sends it to the frame server.

    ``send`` is the connection's ``send``, the one that also carries the world's messages.
    """

    def __init__(self, send: Callable[[Message], None]) -> None:
        self._send = send

    def offers(self) -> frozenset[Fault]:
        """The faults a camera can show."""
        return _OFFERED

    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        """Begin ``fault``; arguments: ``delay_s``, ``jump_s``, ``gain`` (dark), ``serial`` (reboot)."""
        FrameFaults().begin(fault, arguments)  # refuses bad arguments here, where somebody can be told
        self._send(("fault", fault.value, dict(arguments)))

    def clear(self) -> None:
        """End every fault that lasts."""
        self._send(("clear",))


@dataclass
class FrameFaults:
    """The disturbances in force in the frame server."""

    refuse: bool = False
    cut: bool = False  # connections end once
    silent: bool = False
    delay_s: float = 0.0
    junk: bool = False
    freeze: bool = False
    jump_s: float = 0.0
    lost_board: bool = False
    gain: float = 1.0
    serial: str | None = None
    kill: bool = False

    def begin(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        """Put ``fault`` in force; ``ARGUMENT_INVALID`` for an argument it does not take."""
        match fault:
            case Fault.REFUSE:
                self.refuse = self.cut = True
            case Fault.DROP:
                self.cut = True
            case Fault.SILENCE:
                self.silent = True
            case Fault.DELAY:
                self.delay_s = number(arguments, "delay_s", 0.2)
            case Fault.JUNK:
                self.junk = True
            case Fault.FREEZE:
                self.freeze = True
            case Fault.CLOCK_JUMP:
                self.jump_s = number(arguments, "jump_s", 3600.0, low=-1e6)
            case Fault.LOST_BOARD:
                self.lost_board = True
            case Fault.DARK:
                self.gain = number(arguments, "gain", 0.03)
            case Fault.REBOOT:
                self.serial, self.cut = str(arguments.get("serial", "99992299999")), True
            case Fault.KILL:
                self.kill = True

    def clear(self) -> None:
        """Behave again; a camera that came back as another one stays that one."""
        vars(self).update(vars(FrameFaults(serial=self.serial)))

    def take_cut(self) -> bool:
        """Whether connections are to be ended now; true once per fault."""
        cut, self.cut = self.cut, False
        return cut

    def die_if_told(self) -> None:
        """End this process without a word."""
        if self.kill:
            os.kill(os.getpid(), signal.SIGKILL)
