"""One open bus for all who listen on it: two readers of one serial adapter would split its bytes.

``joined`` opens the bus of an address for the first that comes and closes it after the last. The reader is
removed at the first failure: python-can's own would call it tens of thousands of times a second once an
adapter is pulled out.
"""

import asyncio
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import can

from cell.clock import Clock
from cell.errors import CellError, error
from cell.wire_recording.tap import NO_TAP, Tap, tap
from drivers.can_bus.address import BusAddress
from drivers.can_bus.slcan import SerialBus
from drivers.can_bus.socketcand import GatewayBus

SEND_TIMEOUT_S = 0.2
_MOST_AT_ONCE = 512
_QUIET_S = 1.0  # a bus on which nobody was heard for so long is opened anew for who joins it
_BUS_OFF = 0x40  # class of an error frame
_CAN_FRAME = struct.Struct("<IB3x8s")

Ids = Sequence[tuple[int, bool]]
Take = Callable[[Sequence[can.Message], float, float], None]


class Listener(Protocol):
    """Who listens on a bus: to all identifiers of ``ids`` (number, extended)."""

    @property
    def ids(self) -> Ids: ...
    def receive(self, messages: Sequence[can.Message], looked: float, now: float) -> None:
        """Frames of its identifiers, all of which arrived between ``looked`` and ``now`` (monotonic s)."""
        ...

    def hear_error_frame(self) -> None: ...
    def lose(self, why: str, bus_off: bool) -> None:
        """The bus has failed, and is closed."""
        ...


def open_bus(address: BusAddress, timeout: float, ids: Ids = ()) -> can.BusABC:
    """Open the bus, in at most about ``timeout`` seconds; blocks.

    ``ids`` (identifier, extended) are all that will be looked at: the kernel keeps the rest away.
    """
    if address.interface == "slcan":
        return SerialBus(address, SEND_TIMEOUT_S)
    if address.interface == "socketcand":
        return GatewayBus(address, timeout)
    return can.Bus(interface="socketcan", channel=address.channel, can_filters=_filters(ids) or None)


def _kernel_frame(message: can.Message) -> bytes:
    """A frame as ``struct can_frame`` of the kernel: identifier with its flags, length, 8 bytes of data."""
    flags = message.is_extended_id << 31 | message.is_remote_frame << 30 | message.is_error_frame << 29
    return _CAN_FRAME.pack(message.arbitration_id | flags, message.dlc, bytes(message.data))


def _filters(ids: Ids) -> Any:
    return [
        {"can_id": i, "can_mask": 0x1FFFFFFF if extended else 0x7FF, "extended": extended}
        for i, extended in ids
    ]


class SharedBus:
    """The bus of one address with its listeners."""

    def __init__(self, address: BusAddress, clock: Clock) -> None:
        self._address, self._clock = address, clock
        self._listeners: list[Listener] = []
        self._changing, self._sending = asyncio.Lock(), asyncio.Lock()
        self._bus: can.BusABC | None = None
        self._failed: can.BusABC | None = None  # to be closed by the next who joins or leaves
        self._reading: int | None = None
        self._looked = self._heard = 0.0
        self._tap: Tap = NO_TAP  # of a bus without a stream of bytes, which has none of its own

    @property
    def raw(self) -> can.BusABC | None:
        """The open bus, for what only some kinds of it can tell."""
        return self._bus

    async def join(self, listener: Listener, timeout: float) -> None:
        """Hear frames from now on; raises what opening the bus raises, ``TimeoutError`` after about
        ``timeout`` s.

        A bus that is open and has been quiet is opened anew: a gateway that hangs does not say so.
        """
        async with self._changing:
            self._listeners.append(listener)
            try:
                await self._shut_failed()
                if self._bus is not None and self._clock.now() - self._heard > _QUIET_S:
                    await self._shut()
                if self._bus is None:
                    await self._open(timeout)
                elif self._address.interface == "socketcan":
                    self._bus.set_filters(_filters(self._ids()) or None)
            except BaseException as exc:
                self._listeners.remove(listener)
                self._tell_lost(str(exc) or type(exc).__name__, bus_off=False)
                raise

    async def leave(self, listener: Listener) -> None:
        """Hear nothing more; the last one closes the bus."""
        async with self._changing:
            if listener in self._listeners:
                self._listeners.remove(listener)
            await self._shut_failed()
            if not self._listeners:
                await self._shut()

    async def send(self, message: can.Message) -> None:
        """Put a frame on the bus; raises ``CanError`` or ``OSError`` when it does not take it."""
        async with self._sending:
            if self._bus is None:
                raise can.CanOperationError("the bus is not open")
            self._tap.sent(_kernel_frame(message))
            await asyncio.to_thread(self._bus.send, message, SEND_TIMEOUT_S)

    # -- inside

    def _ids(self) -> Ids:
        return sorted({entry for listener in self._listeners for entry in listener.ids})

    async def _open(self, timeout: float) -> None:
        opening = asyncio.create_task(asyncio.to_thread(open_bus, self._address, timeout, self._ids()))
        try:
            async with asyncio.timeout(timeout + 1.0):
                self._bus = bus = await asyncio.shield(opening)
        except BaseException:
            opening.add_done_callback(_shut_late)
            raise
        self._reading = bus.fileno()
        if self._address.interface == "socketcan":
            self._tap = tap("socketcan", self._address.channel)
        self._looked = self._heard = self._clock.now()
        asyncio.get_running_loop().add_reader(self._reading, self._readable, bus)

    async def _shut(self) -> None:
        self._stop_reading()
        bus, self._bus = self._bus, None
        self._tap.closed()
        if bus is not None:
            with suppress(can.CanError, OSError):
                await asyncio.to_thread(bus.shutdown)

    async def _shut_failed(self) -> None:
        failed, self._failed = self._failed, None
        if failed is not None:
            with suppress(can.CanError, OSError):
                await asyncio.to_thread(failed.shutdown)

    def _stop_reading(self) -> None:
        if self._reading is not None:
            asyncio.get_running_loop().remove_reader(self._reading)
            self._reading = None

    def _readable(self, bus: can.BusABC) -> None:
        messages: list[can.Message] = []
        frames: list[bytes] = []
        failure, bus_off = "", False
        try:
            while len(messages) < _MOST_AT_ONCE and (message := bus.recv(0)) is not None:
                if self._tap is not NO_TAP:
                    frames.append(_kernel_frame(message))
                if not message.is_error_frame:
                    messages.append(message)
                    continue
                for listener in tuple(self._listeners):
                    listener.hear_error_frame()
                if message.arbitration_id & _BUS_OFF:
                    failure, bus_off = "bus off", True
                    break
        except (can.CanError, OSError) as exc:
            failure = words(exc)
        looked, self._looked = self._looked, self._clock.now()
        for frame in frames:
            self._tap.received(frame, self._looked)
        if isinstance(bus, GatewayBus):
            bus.record_received(self._looked)
        if messages:
            self._heard = self._looked
            for listener in tuple(self._listeners):
                wanted = set(listener.ids)
                own = [m for m in messages if (m.arbitration_id, m.is_extended_id) in wanted]
                if own:
                    listener.receive(own, looked, self._looked)
        if failure:
            self._tell_lost(failure, bus_off)

    def _tell_lost(self, why: str, bus_off: bool) -> None:
        """Nobody hears anything more; whoever joins next opens the bus again."""
        self._stop_reading()
        bus, self._bus = self._bus, None
        self._failed = bus or self._failed
        lost, self._listeners = self._listeners, []
        for listener in lost:
            listener.lose(why, bus_off)


_OPEN: WeakKeyDictionary[asyncio.AbstractEventLoop, dict[BusAddress, SharedBus]] = WeakKeyDictionary()


def bus_at(address: BusAddress, clock: Clock) -> SharedBus:
    """The one bus of an address on the running loop: a bus is one thing, whoever asks for it."""
    buses = _OPEN.setdefault(asyncio.get_running_loop(), {})
    return buses.setdefault(address, SharedBus(address, clock))


def _shut_late(opening: "asyncio.Task[can.BusABC]") -> None:
    """Nobody waits any more for a bus that opens in the end."""
    if not opening.cancelled() and opening.exception() is None:
        with suppress(can.CanError, OSError):
            opening.result().shutdown()


def words(exc: BaseException) -> str:
    """What the system said."""
    if isinstance(exc, TimeoutError):
        return "no answer in time"
    return str(exc).strip().rstrip(".") or type(exc).__name__


def lost_error(name: str, where: str, why: str, bus_off: bool) -> CellError:
    """``CAN_BUS_OFF`` or ``DEVICE_LOST`` of one who listened."""
    return error(
        "CAN_BUS_OFF" if bus_off else "DEVICE_LOST", f"{name} at {where}{'' if bus_off else f': {why}'}"
    )
