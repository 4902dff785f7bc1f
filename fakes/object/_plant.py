"""A physical device of the object face, which outlives the connections to it, and its driver's link."""

import asyncio
from collections.abc import Callable, Mapping
from math import inf
from typing import Any, Protocol

from cell.clock import Clock
from cell.errors import CellError, error
from fakes.faults.vocabulary import Fault
from fakes.object._lazy import LazyStream


class Plant:
    """What is at the far end of the cable: power, identity, and the faults of the link.

    Subclasses add their own faults to ``faults``. Every change first lets the connections make the samples
    that were due before it (:meth:`settle_past`).
    """

    def __init__(self, name: str, clock: Clock, serial: str) -> None:
        self.name, self.clock, self.serial = name, clock, serial
        self.links: list[ObjectDevice] = []
        self.silent = False
        self.faults: dict[str, Callable[..., None]] = {
            "drop": self._drop,
            "refuse": self._refuse,
            "silence": self._silence,
            "gap": self._gap,
            "reboot": self._reboot,
        }
        self._refused_until = 0.0
        self._timers: list[asyncio.TimerHandle] = []

    def inject(self, kind: str, arguments: Mapping[str, Any] | None = None) -> None:
        """Begin the fault ``kind``; ``ARGUMENT_INVALID`` for an unknown one or a wrong argument."""
        if kind == "clear":
            self.clear()
            return
        fault = self.faults.get(kind)
        if fault is None:
            known = ", ".join(sorted(self.faults))
            raise error("ARGUMENT_INVALID", f"{self.name} has no fault {kind!r}; it has {known}, clear")
        self.settle_past()
        try:
            fault(**(arguments or {}))
        except TypeError as exc:
            raise error("ARGUMENT_INVALID", f"fault {kind} of {self.name}: {exc}") from exc
        self.announce()

    def clear(self) -> None:
        """End every fault that lasts, as an operator who puts the device right."""
        self.settle_past()
        self.silent, self._refused_until = False, 0.0
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        for link in self.links:
            link.stream.resume()
        self.announce()

    @property
    def reachable(self) -> bool:
        return self.clock.now() >= self._refused_until

    def check_reachable(self) -> None:
        """Raise ``DEVICE_UNREACHABLE`` while new connections are refused."""
        if not self.reachable:
            raise error("DEVICE_UNREACHABLE", f"{self.name} refuses connections")

    def settle_past(self) -> None:
        """Make what was due before a change, so that the past stays as it was."""
        for link in self.links:
            link.stream.fill()

    def announce(self) -> None:
        """Tell every connection that something changed."""
        for link in tuple(self.links):
            link.on_change()

    def later(self, seconds: float, action: Callable[[], None]) -> None:
        """Run ``action`` after ``seconds``, unless the faults are cleared before."""
        self._timers = [t for t in self._timers if not t.cancelled() and t.when() > t_now()]
        self._timers.append(asyncio.get_running_loop().call_later(seconds, action))

    def cut(self, why: CellError) -> None:
        """End every connection."""
        for link in tuple(self.links):
            link.lose(why)

    def _drop(self, refuse_s: float = 0.0) -> None:
        self._refused_until = self.clock.now() + refuse_s
        self.cut(error("DEVICE_LOST", f"{self.name} closed the connection"))

    def _refuse(self, duration_s: float = float("inf")) -> None:
        self._drop(duration_s)

    def _silence(self, duration_s: float | None = None) -> None:
        self.silent = True
        for link in self.links:
            link.stream.silence()
            link.expect_loss()
        if duration_s is not None:
            self.later(duration_s, self._end_silence)

    def _end_silence(self) -> None:
        self.silent = False
        for link in self.links:
            link.stream.resume()
        self.announce()

    def _gap(self, count: int = 10) -> None:
        for link in self.links:
            link.stream.skip(count)

    def _reboot(self, serial: str | None = None, boot_s: float = 1.0) -> None:
        self.serial = serial or self.serial
        self._refused_until = self.clock.now() + boot_s
        self.cut(error("DEVICE_LOST", f"{self.name} restarts"))


class OwnFaults(Protocol):
    """The faults of a thing of the world."""

    def offers(self) -> frozenset[Fault]: ...
    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None: ...
    def clear(self) -> None: ...


class FaultyPlant(Plant):
    """A device with faults of its own beside those of every link."""

    def __init__(self, name: str, clock: Clock, serial: str, own: OwnFaults) -> None:
        super().__init__(name, clock, serial)
        self._own = own
        self.faults |= {fault.value: self._named(fault) for fault in own.offers()}

    def clear(self) -> None:
        self.settle_past()
        self._own.clear()
        super().clear()

    def _named(self, fault: Fault) -> Callable[..., None]:
        def begin(duration_s: float | None = None, **arguments: object) -> None:
            if duration_s is not None:
                arguments["for_s"] = duration_s
            self._own.inject(fault, arguments)

        return begin


class ObjectDevice:
    """One driver's connection to a :class:`Plant`: the part of ``cell.devices.Device`` that all share."""

    def __init__(self, name: str, clock: Clock, plant: Plant, lost_after_s: float) -> None:
        self.name, self.clock, self.plant = name, clock, plant
        self.lost: CellError | None = error("DEVICE_LOST", f"{name} is not open")
        self.stream: LazyStream[Any]
        self._lost_after_s = lost_after_s
        self._lost_event = asyncio.Event()
        self._lost_event.set()
        self._change: asyncio.Future[None] | None = None
        self._loss_timer: asyncio.TimerHandle | None = None

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the device refuses."""
        await self.clock.sleep(0.01)
        self.plant.check_reachable()
        if self not in self.plant.links:
            self.plant.links.append(self)
        self.lost = None
        self._lost_event.clear()
        self.stream.start(silent=self.plant.silent)
        if self.plant.silent:
            self.expect_loss()

    async def close(self) -> None:
        """End the connection; harmless when it is not open."""
        if self.lost is None:
            self.lose(error("DEVICE_LOST", f"{self.name} was closed"))

    def lose(self, why: CellError) -> None:
        """The connection is over."""
        if self.lost is not None:
            return
        self.stream.stop()
        self.plant.links.remove(self)
        self.lost = why
        self._lost_event.set()
        if self._loss_timer is not None:
            self._loss_timer.cancel()
            self._loss_timer = None
        self.on_change()

    def expect_loss(self) -> None:
        """A silent link counts as lost after a while."""
        loop = asyncio.get_running_loop()
        self._loss_timer = loop.call_later(self._lost_after_s, self._lose_if_silent)

    def _lose_if_silent(self) -> None:
        if self.plant.silent:
            self.lose(error("DEVICE_LOST", f"{self.name} has sent nothing for {self._lost_after_s:g} s"))

    async def wait_fresh(self, timeout: float) -> None:
        """Return when a sample taken after the call has arrived, else ``DEVICE_LOST``."""
        asked = self.clock.now()
        arrived = asyncio.Event()
        unsubscribe = self.stream.subscribe(lambda sample: arrived.set() if sample.t > asked else None)
        try:
            async with asyncio.timeout(timeout):
                await arrived.wait()
        except TimeoutError:
            raise error("DEVICE_LOST", f"{self.name} gave no fresh sample within {timeout:g} s") from None
        finally:
            unsubscribe()

    async def wait_lost(self) -> Exception:
        """Block while the link is good; return what broke it."""
        while self.lost is None:
            await self._lost_event.wait()
        return self.lost

    def on_change(self) -> None:
        """Wake everybody who waits for something of this device."""
        change, self._change = self._change, None
        if change is not None and not change.done():
            change.set_result(None)

    def next_change(self) -> asyncio.Future[None]:
        """A future that is done at the next change; shared, so nobody may cancel it."""
        if self._change is None:
            self._change = asyncio.get_running_loop().create_future()
        return self._change

    async def wait_change(self, timeout: float = inf) -> None:
        """Return at the next change, or after ``timeout`` seconds."""
        await asyncio.wait({self.next_change()}, timeout=None if timeout == inf else timeout)

    def health(self) -> dict[str, Any]:
        """Plain numbers and texts for status pages."""
        sample = self.stream.last()
        return {
            "connected": self.lost is None,
            "received": self.stream.received,
            "gaps": self.stream.gaps,
            "age_s": None if sample is None else round(self.clock.now() - sample.t, 4),
        }


def t_now() -> float:
    """The running loop's time, which timer handles compare with."""
    return asyncio.get_running_loop().time()
