"""A Modbus device on the twin's switchboard: faults of its wires, and those behind them passed on."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from cell.errors import error
from fakes.actions import Action, Actions, Arguments, amount, switch
from fakes.faults import Fault, Faulty, number
from fakes.modbus_io.module import Module
from fakes.modbus_io.wires import ModuleWires

_JUNK = bytes(range(256))


class ModuleFaults:
    """Injects faults into one device; lasting ones end after ``for_s`` seconds or with ``clear``.

    ``inputs`` is what shows the faults of what the device reads (stuck, bounce, ...). A serial line cannot
    refuse, drop or reset; it shows every other fault of the wires.
    """

    def __init__(self, wires: ModuleWires, inputs: Faulty | None = None) -> None:
        self._wires, self._inputs = wires, inputs
        self._tasks: set[asyncio.Task[None]] = set()
        self._rebooting: asyncio.Task[None] | None = None
        faults = wires.service.faults
        self._actions = Actions(
            {
                Fault.REFUSE: Action(self._refuse, lambda: self._spawn(wires.listen())),
                Fault.DROP: Action(lambda a: wires.cut()),
                Fault.RESET: Action(lambda a: wires.cut(reset=True)),
                Fault.HALF_OPEN: switch(faults.link, "half_open"),
                Fault.SILENCE: switch(faults, "silent"),
                Fault.DELAY: amount(faults.link, "delay_s", 0.05),
                Fault.SPLIT: switch(faults.link, "split"),
                Fault.JUNK: Action(lambda a: wires.junk(_JUNK)),
                Fault.DUPLICATE: switch(faults, "duplicate"),
                Fault.REBOOT: Action(self._reboot, takes=frozenset({"boot_s", "serial"})),
            }
        )

    def offers(self) -> frozenset[Fault]:
        """The faults of the wires and of the inputs."""
        return self._actions.offers() | (self._inputs.offers() if self._inputs else frozenset())

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``for_s`` ends it by itself. ``ARGUMENT_INVALID`` for what it does not take."""
        if fault in self._actions.offers():
            self._actions.inject(fault, arguments)
        elif self._inputs is not None:
            self._inputs.inject(fault, arguments)
            module = self._wires.service.module
            if fault == Fault.WRAP and isinstance(module, Module):
                module.follow_inputs()  # a clear that came before would move the wrap elsewhere

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.end_all()
        if self._inputs is not None:
            self._inputs.clear()

    def close(self) -> None:
        """Forget timers and reboots on their way."""
        self._actions.forget_timers()
        for task in self._tasks:
            task.cancel()

    def _refuse(self, arguments: Arguments) -> None:
        self._wires.refuse()
        self._wires.cut()

    def _reboot(self, arguments: Arguments) -> None:
        serial = str(arguments.get("serial", self._wires.service.module.identity.serial))
        if not serial.isdigit() or not serial.startswith("9999"):
            raise error(
                "ARGUMENT_INVALID", f"serial={serial!r}: twin serials are digits that begin with 9999"
            )
        boot_s = number(arguments, "boot_s", 2.0)
        if self._rebooting is not None:
            self._rebooting.cancel()
        self._rebooting = self._spawn(self._wires.reboot(boot_s, serial))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
