"""Faults that every device on a socket or a serial line shows: cut, silent, late, torn, or rebooting."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Protocol

from cell.errors import error
from fakes.faults.actions import Action, Actions, Arguments, amount, switch
from fakes.faults.vocabulary import Fault, Faulty, LinkFaults, number

_JUNK = bytes(range(256))


class Wires(Protocol):
    """What a device on a wire can be made to do."""

    async def listen(self) -> None: ...
    def refuse(self) -> None: ...
    def cut(self, reset: bool = False) -> None: ...
    def junk(self, data: bytes) -> None: ...
    async def reboot(self, boot_s: float, serial: str) -> None: ...


class Talk(Protocol):
    """How a device answers."""

    silent: bool
    duplicate: bool

    @property
    def link(self) -> LinkFaults: ...


class WireFaults:
    """Injects faults into one device; lasting ones end after ``for_s`` seconds or with ``clear``.

    ``serial`` gives that of the device as it is, ``own`` are faults of its kind, ``behind`` shows those of
    what it reads. A serial line cannot refuse, drop or reset.
    """

    def __init__(
        self,
        wires: Wires,
        talk: Talk,
        serial: Callable[[], str],
        own: Mapping[Fault, Action] | None = None,
        behind: Faulty | None = None,
    ) -> None:
        self._device, self._serial, self._behind = wires, serial, behind
        self._tasks: set[asyncio.Task[None]] = set()
        self._rebooting: asyncio.Task[None] | None = None
        self._actions = Actions(
            {
                Fault.REFUSE: Action(self._refuse, lambda: self._spawn(wires.listen())),
                Fault.DROP: Action(lambda a: wires.cut()),
                Fault.RESET: Action(lambda a: wires.cut(reset=True)),
                Fault.HALF_OPEN: switch(talk.link, "half_open"),
                Fault.SILENCE: switch(talk, "silent"),
                Fault.DELAY: amount(talk.link, "delay_s", 0.05),
                Fault.SPLIT: switch(talk.link, "split"),
                Fault.JUNK: Action(lambda a: wires.junk(_JUNK)),
                Fault.DUPLICATE: switch(talk, "duplicate"),
                Fault.REBOOT: Action(self._reboot, takes=frozenset({"boot_s", "serial"})),
                **(own or {}),
            }
        )

    def offers(self) -> frozenset[Fault]:
        """The faults of the wires and of what is behind them."""
        return self._actions.offers() | (self._behind.offers() if self._behind else frozenset())

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for what it does not take."""
        if fault in self._actions.offers():
            self._actions.inject(fault, arguments)
        elif self._behind is not None:
            self._behind.inject(fault, arguments)

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.end_all()
        if self._behind is not None:
            self._behind.clear()

    def close(self) -> None:
        """Forget timers and reboots on their way."""
        self._actions.forget_timers()
        for task in self._tasks:
            task.cancel()

    def _refuse(self, arguments: Arguments) -> None:
        self._device.refuse()
        self._device.cut()

    def _reboot(self, arguments: Arguments) -> None:
        serial = str(arguments.get("serial", self._serial()))
        if not serial.isdigit() or not serial.startswith("9999"):
            raise error(
                "ARGUMENT_INVALID", f"serial={serial!r}: twin serials are digits that begin with 9999"
            )
        boot_s = number(arguments, "boot_s", 2.0)
        if self._rebooting is not None:
            self._rebooting.cancel()
        self._rebooting = self._spawn(self._device.reboot(boot_s, serial))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
