"""The gripper itself: fingers that take time, what stops them, and the variables that a client sees.

As the maker's manual (2F-85/2F-140, chapter "Control") describes it: ACT 0 resets, ACT 1 activates within a
second or so, GTO lets the fingers go to POS, and OBJ says what ended that.
"""

from collections.abc import Callable
from typing import Protocol

ACTIVATION_S = 1.0
OBJECT_AT = 200
"""Where the fingers meet what is between them, of 255."""
NOT_ACTIVATED = 0x07


class Fingers(Protocol):
    """The physics: it takes or lets go some time after a command (``fakes.world.belt.gripper``)."""

    def command(self, t: float, close: bool) -> None: ...
    def holds(self, t: float) -> object | None: ...


class Hand:
    """``now()`` is cell time, s; ``way_s`` is how long the fingers take from 0 to where they meet a thing."""

    def __init__(self, fingers: Fingers, way_s: float, now: Callable[[], float]) -> None:
        self._fingers, self._now = fingers, now
        self._rate = OBJECT_AT / max(way_s, 1e-3)  # counts a second
        self.fault = 0
        self.values = {"ACT": 0, "GTO": 0, "ATR": 0, "ADR": 0, "POS": 0, "SPE": 0, "FOR": 0}
        self._active_at: float | None = None
        self._since, self._from, self._to = now(), 0.0, 0.0
        self._met = False  # a thing that was between the fingers when they got to it

    # -- what a client reads

    def read(self, name: str) -> int | None:
        """A variable by the name that the URCap gives it; None for one that it does not know."""
        if name in self.values and name != "POS":
            return self.values[name]
        return {
            "POS": round(self.position()),
            "PRE": self.values["POS"],
            "STA": self.activation(),
            "OBJ": self.object(),
            "FLT": self.fault or self._not_activated(),
            "COU": 30 if self.object() == 2 else 0,
        }.get(name)

    def activation(self) -> int:
        """gSTA: 0 reset, 1 activating, 3 active."""
        if self._active_at is None:
            return 0
        return 3 if self._now() >= self._active_at else 1

    def position(self) -> float:
        """Of the fingers, 0 to 255."""
        self._meet()
        return self._position(self._now())

    def object(self) -> int:
        """gOBJ: 0 moving, or not told to go; 1, 2 stopped by a thing while opening, closing; 3 arrived."""
        at = self.position()
        if not self.values["GTO"]:
            return 0
        if self._blocked(self._now()):
            return 2
        return 3 if at == self._to else 0

    # -- what a client writes

    def write(self, values: dict[str, int]) -> None:
        """Take variables as they are given together; the fingers go when GTO is on."""
        before = self.values["ACT"]
        at = self.position()
        self.values |= values
        now = self._now()
        if not self.values["ACT"]:
            self._active_at, self.fault, self.values["GTO"] = None, 0, 0
            self._go(now, at, at)
        elif not before:
            self._active_at = now + ACTIVATION_S
        elif self.values["GTO"] and self.activation() == 3:
            self._go(now, at, float(self.values["POS"]))

    # -- inside

    def _go(self, now: float, at: float, to: float) -> None:
        if to == self._to:
            return
        self._since, self._from, self._to = now, at, to
        self._met = False
        self._fingers.command(now, to > at)

    def _meet(self) -> None:
        """Notice a thing when the fingers get to where it is; not one that comes later."""
        reached = self._since + (OBJECT_AT - self._from) / self._rate
        if self._to > OBJECT_AT >= self._from and not self._met and self._now() >= reached:
            self._met = self._fingers.holds(self._now()) is not None

    def _blocked(self, now: float) -> bool:
        return self._met and self._to > OBJECT_AT and self._fingers.holds(now) is not None

    def _position(self, now: float) -> float:
        if self._blocked(now):
            return float(OBJECT_AT)
        way = self._rate * (now - self._since)
        return min(self._from + way, self._to) if self._to > self._from else max(self._from - way, self._to)

    def _not_activated(self) -> int:
        return NOT_ACTIVATED if self.values["GTO"] and self.activation() == 0 else 0
