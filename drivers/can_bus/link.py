"""One listener's end of a CAN bus: no threads, one call for all its frames, one word on the bus's end."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, cast

import can

from cell.clock import Clock
from cell.errors import CellError, error
from drivers.can_bus.address import parse_bus
from drivers.can_bus.shared import Ids, SharedBus, Take, bus_at, lost_error, words
from drivers.can_bus.slcan import SerialBus

# An answer takes milliseconds. It is waited for in steps, so that a pause of this process does not use it up.
_FLAGS_LOOKS, _FLAGS_LOOK_S = 20, 0.01
_FLAG_WORDS = {
    0x01: "receive buffer full",
    0x02: "transmit buffer full",
    0x04: "error warning",
    0x08: "data overrun",
    0x20: "error passive",
    0x40: "arbitration lost",
    0x80: "bus error",
}


class CanLink:
    """``take(messages, looked, now)`` gets frames and the bracket (monotonic s) in which they arrived.

    ``lost(error)`` is called once, when the link has failed by itself. ``ids`` (identifier, extended) are
    those that matter. The bus is shared with all other links to the same address.
    """

    def __init__(
        self,
        name: str,
        bus: str,
        ids: Ids,
        take: Take,
        lost: Callable[[CellError], Any],
        clock: Clock,
    ) -> None:
        self.ids = ids
        self._name, self._where, self._address = name, bus, parse_bus(bus)
        self._take, self._lost, self._clock = take, lost, clock
        self._bus: SharedBus | None = None
        self.frames = 0
        self.error_frames = 0

    async def open(self, timeout: float) -> None:
        """Begin to listen; ``DEVICE_UNREACHABLE`` with what the system said."""
        bus = bus_at(self._address, self._clock)
        try:
            await bus.join(self, timeout)
        except (can.CanError, OSError, TimeoutError, ValueError) as exc:
            raise error("DEVICE_UNREACHABLE", f"{self._name} at {self._where}: {words(exc)}") from exc
        self._bus = bus

    async def close(self) -> None:
        """Stop listening."""
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.leave(self)

    async def send(self, identifier: int, data: bytes) -> None:
        """Send a frame with an 11-bit identifier; ``DEVICE_LOST`` when the bus does not take it."""
        bus = self._bus
        if bus is None:
            raise error("DEVICE_LOST", f"{self._name} at {self._where} is not open")
        try:
            await bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        except (can.CanError, OSError) as exc:
            raise error("DEVICE_LOST", f"{self._name} at {self._where}: {words(exc)}") from exc

    async def why_silent(self) -> str:
        """What the adapter knows of the bus; only serial ones must be asked."""
        raw = None if self._bus is None else self._bus.raw
        if not isinstance(raw, SerialBus):
            return ""
        with suppress(can.CanError, OSError):
            await asyncio.to_thread(raw.ask_flags)
            for _ in range(_FLAGS_LOOKS):
                if raw.flags is not None:
                    break
                await asyncio.sleep(_FLAGS_LOOK_S)
        flags = raw.flags or 0
        return ", ".join(text for bit, text in _FLAG_WORDS.items() if flags & bit)

    @property
    def malformed(self) -> int:
        """Lines of the adapter or gateway that were no frames."""
        raw = None if self._bus is None else self._bus.raw
        return cast(int, getattr(raw, "malformed", 0))

    # -- what the bus tells

    def receive(self, messages: Sequence[can.Message], looked: float, now: float) -> None:
        self.frames += len(messages)
        self._take(messages, looked, now)

    def hear_error_frame(self) -> None:
        self.error_frames += 1

    def lose(self, why: str, bus_off: bool) -> None:
        self._lost(lost_error(self._name, self._where, why, bus_off))
