"""What a Robotiq gripper says and is told, as numbers: its registers, and the faults of its manual.

Source: Robotiq, instruction manuals of 2F-85/2F-140 and Hand-E, chapter "Control": registers 03E8h to 03EAh
are written, 07D0h to 07D2h are read. The socket of its URCap has the same numbers under names.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

WRITTEN, READ, REGISTERS = 0x03E8, 0x07D0, 3
_ACTIVATE, _GO = 0x01, 0x08
MINOR_FAULTS = frozenset({0x05, 0x07})
"""They say that it is not activated, which has an error of its own."""

FAULTS = {
    0x05: "it has to be activated again before it moves",
    0x07: "it has to be activated before it moves",
    0x08: "it is too hot: let it cool down",
    0x09: "it heard nothing for a second",
    0x0A: "its supply voltage is too low",
    0x0B: "it lets go by itself (automatic release)",
    0x0C: "an internal fault",
    0x0D: "its activation failed: look for something between the fingers",
    0x0E: "its current is too high",
    0x0F: "it has let go by itself: activate it again",
}


class Activation(IntEnum):
    """gSTA: whether it is activated."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class Fingers(IntEnum):
    """gOBJ: what stopped the fingers."""

    MOVING = 0
    BLOCKED_OPENING = 1
    BLOCKED_CLOSING = 2
    ARRIVED = 3


@dataclass(frozen=True)
class RobotiqState:
    """``requested`` and ``position`` are 0 (open) to 255 (closed)."""

    activation: int
    fingers: Fingers
    fault: int
    requested: int
    position: int

    @classmethod
    def from_registers(cls, words: Sequence[int]) -> "RobotiqState":
        """From the three registers at 07D0h; of each the high byte comes first."""
        status, fault = words[0] >> 8, words[1] >> 8
        return cls(status >> 4 & 3, Fingers(status >> 6 & 3), fault & 0x0F, words[1] & 0xFF, words[2] >> 8)


def activate_words(on: bool) -> list[int]:
    """For 03E8h: activate, or reset."""
    return [(_ACTIVATE if on else 0) << 8, 0, 0]


def move_words(position: int, speed: int, force: int) -> list[int]:
    """For 03E8h: go to ``position``; all are 0 to 255."""
    return [(_ACTIVATE | _GO) << 8, position, speed << 8 | force]
