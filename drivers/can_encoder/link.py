"""A CAN bus on the event loop: no threads, one call for all frames that have arrived, one word on its end.

The reader is removed at the first failure: python-can's own would call it tens of thousands of times a
second once an adapter is pulled out.
"""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, cast

import can

from cell.clock import Clock
from cell.errors import CellError, error
from drivers.can_encoder.bus_address import BusAddress, parse_bus
from drivers.can_encoder.slcan import SerialBus
from drivers.can_encoder.socketcand import GatewayBus

SEND_TIMEOUT_S = 0.2
_MOST_AT_ONCE = 512
# An answer takes milliseconds. It is waited for in steps, so that a pause of this process does not use it up.
_FLAGS_LOOKS, _FLAGS_LOOK_S = 20, 0.01
_BUS_OFF = 0x40  # class of an error frame
_FLAG_WORDS = {
    0x01: "receive buffer full",
    0x02: "transmit buffer full",
    0x04: "error warning",
    0x08: "data overrun",
    0x20: "error passive",
    0x40: "arbitration lost",
    0x80: "bus error",
}

Take = Callable[[Sequence[can.Message], float, float], None]


def open_bus(address: BusAddress, timeout: float, ids: Sequence[tuple[int, bool]] = ()) -> can.BusABC:
    """Open the bus, in at most about ``timeout`` seconds; blocks.

    ``ids`` (identifier, extended) are all that will be looked at: the kernel keeps the rest away.
    """
    if address.interface == "slcan":
        return SerialBus(address, SEND_TIMEOUT_S)
    if address.interface == "socketcand":
        return GatewayBus(address, timeout)
    filters: Any = [
        {"can_id": i, "can_mask": 0x1FFFFFFF if extended else 0x7FF, "extended": extended}
        for i, extended in ids
    ]
    return can.Bus(interface="socketcan", channel=address.channel, can_filters=filters or None)


class CanLink:
    """``take(messages, looked, now)`` gets frames and the bracket (monotonic s) in which they arrived.

    ``lost(error)`` is called once, when the link has failed by itself. ``ids`` are those that matter.
    """

    def __init__(
        self,
        name: str,
        bus: str,
        ids: Sequence[tuple[int, bool]],
        take: Take,
        lost: Callable[[CellError], Any],
        clock: Clock,
    ) -> None:
        self._name, self._where, self._address, self._ids = name, bus, parse_bus(bus), ids
        self._take, self._lost, self._clock = take, lost, clock
        self._bus: can.BusABC | None = None
        self._reading: int | None = None
        self._looked = 0.0
        self.frames = 0
        self.error_frames = 0

    async def open(self, timeout: float) -> None:
        """Open the bus and begin to read; ``DEVICE_UNREACHABLE`` with what the system said."""
        opening = asyncio.create_task(asyncio.to_thread(open_bus, self._address, timeout, self._ids))
        try:
            async with asyncio.timeout(timeout + 1.0):
                self._bus = bus = await asyncio.shield(opening)
        except BaseException as exc:
            opening.add_done_callback(_shut_late)
            if isinstance(exc, can.CanError | OSError | TimeoutError | ValueError):
                raise error("DEVICE_UNREACHABLE", f"{self._name} at {self._where}: {_words(exc)}") from exc
            raise
        self._reading = bus.fileno()
        self._looked = self._clock.now()
        asyncio.get_running_loop().add_reader(self._reading, self._readable, bus)

    async def close(self) -> None:
        """Stop reading and close the bus."""
        self._stop_reading()
        bus, self._bus = self._bus, None
        if bus is not None:
            with suppress(can.CanError, OSError):
                await asyncio.to_thread(bus.shutdown)

    async def send(self, identifier: int, data: bytes) -> None:
        """Send a frame with an 11-bit identifier; ``DEVICE_LOST`` when the bus does not take it."""
        bus = self._bus
        if bus is None:
            raise error("DEVICE_LOST", f"{self._name} at {self._where} is not open")
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        try:
            await asyncio.to_thread(bus.send, message, SEND_TIMEOUT_S)
        except (can.CanError, OSError) as exc:
            raise error("DEVICE_LOST", f"{self._name} at {self._where}: {_words(exc)}") from exc

    async def why_silent(self) -> str:
        """What the adapter knows of the bus; only serial ones must be asked."""
        bus = self._bus
        if not isinstance(bus, SerialBus):
            return ""
        with suppress(can.CanError, OSError):
            await asyncio.to_thread(bus.ask_flags)
            for _ in range(_FLAGS_LOOKS):
                if bus.flags is not None:
                    break
                await asyncio.sleep(_FLAGS_LOOK_S)
        flags = bus.flags or 0
        return ", ".join(words for bit, words in _FLAG_WORDS.items() if flags & bit)

    @property
    def malformed(self) -> int:
        """Lines of the adapter or gateway that were no frames."""
        return cast(int, getattr(self._bus, "malformed", 0))

    def _readable(self, bus: can.BusABC) -> None:
        messages: list[can.Message] = []
        failure: CellError | None = None
        try:
            while len(messages) < _MOST_AT_ONCE and (message := bus.recv(0)) is not None:
                if not message.is_error_frame:
                    messages.append(message)
                    continue
                self.error_frames += 1
                if message.arbitration_id & _BUS_OFF:
                    failure = error("CAN_BUS_OFF", f"{self._name} at {self._where}")
                    break
        except (can.CanError, OSError) as exc:
            failure = error("DEVICE_LOST", f"{self._name} at {self._where}: {_words(exc)}")
        looked, self._looked = self._looked, self._clock.now()
        self.frames += len(messages)
        if messages:
            self._take(messages, looked, self._looked)
        if failure is not None:
            self._stop_reading()
            self._lost(failure)

    def _stop_reading(self) -> None:
        if self._reading is not None:
            asyncio.get_running_loop().remove_reader(self._reading)
            self._reading = None


def _shut_late(opening: "asyncio.Task[can.BusABC]") -> None:
    """Nobody waits any more for a bus that opens in the end."""
    if not opening.cancelled() and opening.exception() is None:
        with suppress(can.CanError, OSError):
            opening.result().shutdown()


def _words(exc: BaseException) -> str:
    if isinstance(exc, TimeoutError):
        return "no answer in time"
    return str(exc).strip().rstrip(".") or type(exc).__name__
