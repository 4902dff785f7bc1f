"""Device supervision: connecting, identity, loss and reconnection live here and nowhere else."""

import asyncio
import logging
import random
from collections.abc import Coroutine, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

from cell.clock import Clock
from cell.devices import Device, DeviceState, Identity
from cell.errors import CellError, error
from cell.interruptions import SILENCES
from daemon.health import Beats

T = TypeVar("T")

log = logging.getLogger("cellward.devices")

OPEN_TIMEOUT_S = 20.0
CLOSE_TIMEOUT_S = 5.0
FRESH_TIMEOUT_S = 2.0
FIRST_BACK_OFF_S = 0.25
LONGEST_BACK_OFF_S = 5.0
BEAT_S = 0.5
SETTLE_S = 0.02
NO_SERIAL_S = 10.0  # a device that told no serial for so long was not silent by chance
SOON_S = 3.0  # after a loss: who waits for a device that was silent for a moment waits for this


@dataclass(frozen=True)
class ExpectedIdentity:
    """What the configuration says about a device's identity."""

    twin: bool
    serial: str | None = None

    def check(self, device: str, found: Identity) -> None:
        """Raise ``DEVICE_IDENTITY`` when the device is not the one that is meant.

        One that tells no serial may have been silent when it was asked, so it is to be asked again:
        ``DEVICE_UNREACHABLE``.
        """
        if self.misses_serial(found):
            raise error("DEVICE_UNREACHABLE", f"{device} told no serial, {self._wanted(device)}")
        if self.serial is not None and found.serial != self.serial:
            raise error(
                "DEVICE_IDENTITY", f"{device} has serial {found.serial}, the config expects {self.serial}"
            )
        if found.is_twin != self.twin:
            kind = "a twin" if found.is_twin else "real hardware"
            raise error(
                "DEVICE_IDENTITY", f"{device} is {kind} but the config says twin = {str(self.twin).lower()}"
            )

    def misses_serial(self, found: Identity) -> bool:
        """Whether a serial is needed that the device did not tell: it has none, or it was silent."""
        return not found.serial and (self.serial is not None or self.twin)

    def without_serial(self, device: str) -> CellError:
        """Of a device that answers, and goes on telling none."""
        return error("DEVICE_IDENTITY", f"{device} answers and tells no serial, {self._wanted(device)}")

    def _wanted(self, device: str) -> str:
        if self.serial is None:
            return (
                "and the config says twin = true, where each has one that begins with 9999; if this is real "
                f"hardware, write twin = false; else say in [device.{device}] where the serial is, if its "
                "driver has a key for it"
            )
        return (
            f"the config expects {self.serial}; if it has none, take expect_serial out of [device.{device}], "
            "or say there where the serial is, if its driver has a key for it"
        )


class SupervisedDevice:
    """One device through its life: CONNECTING, READY, and RETRYING with capped back-off and jitter."""

    def __init__(self, device: Device, expect: ExpectedIdentity, clock: Clock, beats: Beats) -> None:
        self.device, self.expect = device, expect
        self.state = DeviceState.CLOSED
        self.identity: Identity | None = None
        self.last_error: Exception | None = None
        self.lost_by: Exception | None = None  # since it was last ready
        self.losses = 0
        self.changed = asyncio.Event()
        self._no_serial_since: float | None = None
        self._clock, self._beats = clock, beats
        self._task_name = f"device {device.name}"

    async def run(self) -> None:
        """Keep the device connected until cancelled; always leaves it closed."""
        back_off = FIRST_BACK_OFF_S
        lost_at: float | None = None
        try:
            while True:
                self._set(DeviceState.CONNECTING if lost_at is None else DeviceState.RETRYING)
                try:
                    found = await self._beating(self._connect())
                except Exception as exc:
                    self._failed(exc, first=lost_at is None)
                    lost_at = self._clock.now() if lost_at is None else lost_at
                else:
                    self._recovered(found, lost_at)
                    back_off = FIRST_BACK_OFF_S
                    loss = await self._beating(self.device.wait_lost())
                    self.losses += 1
                    lost_at = self._clock.now()
                    self.lost_by = loss
                    self._failed(loss, first=True)
                await self._beating(self._close())
                await self._beating(self._clock.sleep(back_off * random.uniform(0.8, 1.2)))
                if lost_at is None or self._clock.now() - lost_at > SOON_S:
                    back_off = min(2.0 * back_off, LONGEST_BACK_OFF_S)
        finally:
            await self._close()
            self._set(DeviceState.CLOSED)
            self._beats.retire(self._task_name)

    async def _connect(self) -> Identity:
        async with asyncio.timeout(OPEN_TIMEOUT_S):
            try:
                await self.device.open()
                found = await self.device.identify()
            except BaseException:
                self._no_serial_since = None  # it is silent
                raise
            self._check_identity(found)
            await self._fresh()
        return found

    def _check_identity(self, found: Identity) -> None:
        """As :meth:`ExpectedIdentity.check`; ``DEVICE_IDENTITY`` for a device that answers at each connection
        and tells no serial for ``NO_SERIAL_S``, too."""
        if not self.expect.misses_serial(found):
            self._no_serial_since = None
        elif self._no_serial_since is None:
            self._no_serial_since = self._clock.now()
        elif self._clock.now() - self._no_serial_since > NO_SERIAL_S:
            raise self.expect.without_serial(self.device.name)
        self.expect.check(self.device.name, found)

    async def _fresh(self) -> None:
        """A first sample; a link that is lost again meanwhile is not waited for."""
        fresh = asyncio.create_task(self.device.wait_fresh(FRESH_TIMEOUT_S))
        lost = asyncio.create_task(self.device.wait_lost())
        try:
            await asyncio.wait([fresh, lost], return_when=asyncio.FIRST_COMPLETED)
            if not fresh.done():
                raise lost.result()
            fresh.result()
        finally:
            for task in (fresh, lost):
                task.cancel()
            await asyncio.wait([fresh, lost])

    async def _close(self) -> None:
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await self.device.close()
        except Exception as exc:
            log.warning("%s: closing failed: %s: %s", self.device.name, type(exc).__name__, exc)

    def _recovered(self, found: Identity, lost_at: float | None) -> None:
        self.identity = found
        self._set(DeviceState.READY)
        self.last_error = self.lost_by = None
        outage = "" if lost_at is None else f" after {self._clock.now() - lost_at:.1f} s"
        log.info("%s: ready%s (%s, serial %s)", self.device.name, outage, found.model, found.serial)

    def _failed(self, exc: Exception, first: bool) -> None:
        self.last_error = exc
        refused = isinstance(exc, CellError) and exc.name == "DEVICE_IDENTITY"
        another = refused and self.state is not DeviceState.FAULTED  # a stranger where our device was
        self._set(DeviceState.FAULTED if refused else DeviceState.RETRYING)
        if first or another:
            log.warning("%s: %s", self.device.name, _reason(exc))

    def _set(self, state: DeviceState) -> None:
        if state is self.state or (self.state is DeviceState.FAULTED and state is DeviceState.RETRYING):
            return
        self.state = state
        self.changed.set()
        self.changed = asyncio.Event()

    async def _beating(self, work: Coroutine[Any, Any, T]) -> T:
        """Await ``work`` and beat meanwhile: waiting for a device is not being stuck."""
        task = asyncio.ensure_future(work)
        try:
            while not task.done():
                self._beats.beat(self._task_name)
                await asyncio.wait([task], timeout=BEAT_S)
        except BaseException:
            task.cancel()
            await asyncio.wait([task], timeout=CLOSE_TIMEOUT_S)
            raise
        return task.result()

    @property
    def lasting(self) -> Exception | None:
        """What does not pass by itself while the device is not READY."""
        if self.state is DeviceState.FAULTED:
            return self.last_error
        silent = not isinstance(self.lost_by, CellError) or self.lost_by.name in SILENCES
        return None if silent else self.lost_by

    def status(self) -> dict[str, Any]:
        """For status pages and ``cellward status``."""
        return {
            "state": self.state.value,
            "model": self.identity.model if self.identity else None,
            "serial": self.identity.serial if self.identity else None,
            "losses": self.losses,
            "error": _reason(self.last_error) if self.last_error else None,
            **self.device.health(),
        }


def _reason(exc: Exception) -> str:
    return f"{exc} ({exc.code}). {exc.hint}" if isinstance(exc, CellError) else f"{type(exc).__name__}: {exc}"


class Supervisor:
    """All devices of the cell."""

    def __init__(self, devices: Iterable[SupervisedDevice]) -> None:
        self.devices = {d.device.name: d for d in devices}

    def ready(self, name: str) -> Device:
        """The device, if it can be used now; else ``DEVICE_NOT_READY`` with its last error."""
        entry = self.devices[name]
        if entry.state is not DeviceState.READY:
            why = _reason(entry.last_error) if entry.last_error else entry.state.value
            raise error("DEVICE_NOT_READY", f"{name}: {why}")
        return entry.device

    async def first_loss(self, names: Iterable[str]) -> Exception:
        """Block until one of the devices is no longer READY; return why."""
        watched = tuple(names)
        while (loss := self.loss(watched)) is None:
            await self._change_of(watched)
        return loss

    async def back(self, names: Iterable[str]) -> None:
        """Return when all of the devices are READY and have given a fresh sample; raise what cannot pass.

        That is a loss that was no silence, and another device in the place of ours. A connection that fails
        is tried again by the device's own task.
        """
        wanted = tuple(names)
        while True:
            if self.loss(wanted) is not None:
                for entry in (self.devices[name] for name in wanted):
                    if (fault := entry.lasting) is not None:
                        raise fault
                await self._change_of(wanted)
                continue
            try:
                for name in wanted:
                    await self.devices[name].device.wait_fresh(FRESH_TIMEOUT_S)
                return
            except CellError:  # it is about to be seen as lost
                await asyncio.sleep(SETTLE_S)

    async def _change_of(self, names: Iterable[str]) -> None:
        waits = [asyncio.create_task(self.devices[name].changed.wait()) for name in names]
        try:
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()

    def loss(self, names: Iterable[str]) -> Exception | None:
        """Why the first of the devices that is not READY is not; None when all are."""
        for entry in (self.devices[name] for name in names):
            if entry.state is not DeviceState.READY:
                return entry.last_error or error("DEVICE_LOST", f"{entry.device.name} is {entry.state.value}")
        return None

    def status(self) -> dict[str, Any]:
        return {name: entry.status() for name, entry in self.devices.items()}
