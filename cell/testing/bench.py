"""The bench of a contract suite: it opens the device, plays a scene with it, and closes it."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Container, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import pytest

from cell.clock import Clock, MonotonicClock
from cell.devices import Device, Identity
from cell.errors import CellError
from cell.testing import taken_again

D = TypeVar("D", bound=Device)
T = TypeVar("T")


async def no_fault(kind: str, **_: Any) -> None:
    """The ``inject`` of a bench that cannot make faults."""
    raise ValueError(f"this bench cannot make the fault {kind!r}; say so in its lacks")


@dataclass
class Rig(Generic[D]):
    """One open device, and what makes its faults.

    ``inject(kind, **arguments)`` begins a fault, ``inject("clear")`` ends all of them. ``identity`` is
    what the device ought to say of itself, as far as it is not empty.
    """

    device: D
    clock: Clock
    identity: Identity | None = field(default=None, kw_only=True)
    inject: Callable[..., Awaitable[None]] = field(default=no_fault, kw_only=True)

    async def loss(self, within_s: float) -> CellError:
        """What ended the link; it must come within the time."""
        async with asyncio.timeout(within_s):
            found = await self.device.wait_lost()
        assert isinstance(found, CellError)
        return found

    async def reopen(self, within_s: float = 6.0) -> None:
        """As the supervisor does: until it opens and gives a sample."""
        async with asyncio.timeout(within_s):
            while True:
                await self.device.close()
                try:
                    await self.device.open()
                    await self.device.wait_fresh(1.0)
                    return
                except CellError as exc:
                    if exc.name not in ("DEVICE_UNREACHABLE", "DEVICE_LOST", "CAN_BUS_OFF"):
                        raise
                await self.clock.sleep(0.05)


R = TypeVar("R", bound=Rig[Any])


class _Everything:
    def __contains__(self, _: object) -> bool:
        return True


EVERYTHING: Container[str] = _Everything()


@dataclass(frozen=True)
class Bench(Generic[R]):
    """What the fixture ``subject`` of a suite is.

    ``rig`` yields a rig with the device open. ``run`` runs a coroutine to its end. ``lacks`` names what the
    bench cannot show: kinds of faults, ``truth`` (the values that the device ought to measure), and
    ``motion`` (an arm may be moved); cases that need one of them are skipped. ``retried``: a scene that a
    pause of the machine interrupted is played again.
    """

    rig: Callable[..., AbstractAsyncContextManager[R]]
    run: Callable[[Coroutine[Any, Any, Any]], Any] = asyncio.run
    lacks: Container[str] = frozenset()
    retried: bool = False

    def __call__(self, scene: Callable[[R], Coroutine[Any, Any, Any]], **options: Any) -> Any:
        """The result of ``scene`` with the device open; ``options`` are for ``rig``."""

        async def whole() -> Any:
            async with self.rig(**options) as rig:
                return await scene(rig)

        return taken_again.play(whole, self.run) if self.retried else self.run(whole())

    def needs(self, *what: str) -> None:
        """Skip the case when the bench lacks one of these."""
        missing = [name for name in what if name in self.lacks]
        if missing:
            pytest.skip(f"this bench has no {', no '.join(missing)}")


class Made(Protocol):
    """A driver's class, as the configuration of a cell uses it."""

    @property
    def Config(self) -> Callable[..., Any]: ...

    def __call__(self, name: str, config: Any, clock: Clock) -> Any: ...


def bench(
    rig: Callable[[Any, Clock], R],
    driver: Made,
    *,
    prepare: Callable[[R], None] = lambda _: None,
    lacks: Container[str] = EVERYTHING,
    **config: Any,
) -> Bench[R]:
    """A bench for ``driver`` with the keys ``config``, on real time.

    ``prepare`` may give the rig what it needs beside the device, such as ``inject``; ``lacks`` then names
    what is still missing. Without them the cases run that need neither faults nor known values.
    """

    @asynccontextmanager
    async def opened() -> AsyncIterator[R]:
        clock = MonotonicClock()
        device = driver("subject", driver.Config(**config), clock)
        made = rig(device, clock)
        prepare(made)
        try:
            await device.open()
            yield made
        finally:
            await device.close()

    return Bench(opened, lacks=lacks)


def known(value: T | None, what: str) -> T:
    """A value of the rig that the case at hand needs."""
    if value is None:
        raise ValueError(f"the rig has no {what}; the bench must name it in its lacks")
    return value
