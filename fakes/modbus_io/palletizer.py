"""The registers of the palletizer's controller: its joints, what its program does, and what is asked of it.

Holding registers, mirrored as input registers; a joint takes two:

| address | meaning |
|---|---|
| 0 .. 7 | joints 1 .. 4, float32 or int32, in the controller's unit |
| 8 | bit 0: the arm moves |
| 9 | status: 0 idle, 1 busy, 2 there, 3 refused |
| 10 | number of the pose at which the arm stands, 0 none |
| 20 .. 27 | joints that are asked for; written |
| 28 | number of the pose that is asked for; written last, 0 takes it back |
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import degrees, radians
from typing import Any

from fakes.modbus_io.module import Action, Identity
from fakes.modbus_io.pdu import ILLEGAL_ADDRESS, Refused
from fakes.world.palletizer.observed import ObservedPalletizer

JOINTS, MOVING, STATUS, REACHED, TARGETS, NUMBER = 0, 8, 9, 10, 20, 28
_LARGEST_INT = (1 << 31) - 1


class ObservedRegisters:
    """:class:`fakes.modbus_io.module.Unit` of one palletizer at the instants that ``now`` gives."""

    def __init__(self, arm: ObservedPalletizer, now: Callable[[], float]) -> None:
        self.arm, self._now = arm, now
        self.identity = Identity(arm.truth.model, arm.truth.serial, revision=arm.truth.version)
        self._targets = [0] * (2 * arm.axes)
        self._number = 0

    def coils(self) -> Mapping[int, bool]:
        return {}

    def discrete(self) -> Mapping[int, bool]:
        return {}

    def input(self) -> Mapping[int, int]:
        return self.holding()

    def holding(self) -> Mapping[int, int]:
        t = self._now()
        words = [word for q in self.arm.joints(t) for word in self._words(float(q))]
        return {
            **dict(enumerate(words, JOINTS)),
            MOVING: int(self.arm.moving(t)),
            STATUS: int(self.arm.status(t)),
            REACHED: self.arm.reached(t),
            **dict(enumerate(self._targets, TARGETS)),
            NUMBER: self._number,
        }

    def coil(self, address: int, on: bool) -> Action:
        raise Refused(ILLEGAL_ADDRESS)

    def register(self, address: int, value: int) -> Action:
        if address == NUMBER:
            return lambda: self._ask(value)
        if not TARGETS <= address < TARGETS + len(self._targets):
            raise Refused(ILLEGAL_ADDRESS)
        return lambda: self._targets.__setitem__(address - TARGETS, value)

    def restart(self, serial: str | None = None) -> None:
        """The request is forgotten; the arm is where it is."""
        self._targets, self._number = [0] * len(self._targets), 0
        self.arm.request(self._now(), 0, [])
        if serial is not None:
            self.identity = replace(self.identity, serial=serial)

    def device(self) -> dict[str, Any]:
        """Keys with which a daemon's driver reads and asks this controller."""
        truth = self.arm.truth
        joint: dict[str, Any] = {"type": truth.number, "unit": truth.unit, "word_order": truth.word_order}
        if truth.number == "int32":
            joint["scale"] = truth.scale
        return {
            "joints": [{"address": JOINTS + 2 * i, **joint} for i in range(self.arm.axes)],
            "moving": {"address": MOVING, "bit": 0},
            "handshake": {
                "targets": [TARGETS + 2 * i for i in range(self.arm.axes)],
                "number": NUMBER,
                "reached": REACHED,
            },
        }

    def _ask(self, number: int) -> None:
        if number != self._number:
            self._number = number
            pairs = zip(self._targets[::2], self._targets[1::2], strict=True)
            self.arm.request(self._now(), number, [self._angle(pair) for pair in pairs])

    def _words(self, q: float) -> tuple[int, int]:
        shown = degrees(q) if self.arm.truth.unit == "deg" else q
        if self.arm.truth.number == "float32":
            raw = struct.pack(">f", shown)
        else:
            steps = round(shown / self.arm.truth.scale)
            raw = struct.pack(">i", max(-_LARGEST_INT, min(steps, _LARGEST_INT)))
        high, low = struct.unpack(">HH", raw)
        return (high, low) if self.arm.truth.word_order == "high-first" else (low, high)

    def _angle(self, words: tuple[int, int]) -> float:
        high, low = words if self.arm.truth.word_order == "high-first" else words[::-1]
        raw = struct.pack(">HH", high, low)
        if self.arm.truth.number == "float32":
            shown = struct.unpack(">f", raw)[0]
        else:
            shown = struct.unpack(">i", raw)[0] * self.arm.truth.scale
        return float(radians(shown)) if self.arm.truth.unit == "deg" else float(shown)
