"""The station on the twin's switchboard: faults of its wires, and those of the tracker passed on."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from cell.errors import error
from fakes.actions import Action, Actions, Arguments, amount, switch
from fakes.faults import Fault, Faulty, number
from fakes.geocom.instrument import EVERY
from fakes.geocom.wires import StationWires

_JUNK = bytes(range(256))
_LARGEST_CODE = 65535


class StationFaults:
    """Injects faults into one station; lasting ones end after ``for_s`` seconds or with ``clear``.

    ``tracker`` is what shows the faults of the instrument itself. ``return-code`` takes ``code`` and ``rpc``
    (every procedure without it), ``gap`` takes ``count``, the answers that get lost. A serial line cannot
    refuse, drop or reset.
    """

    def __init__(self, wires: StationWires, tracker: Faulty) -> None:
        self._wires, self._tracker = wires, tracker
        self._tasks: set[asyncio.Task[None]] = set()
        self._rebooting: asyncio.Task[None] | None = None
        faults = wires.faults
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
                Fault.GAP: Action(self._lose, takes=frozenset({"count"})),
                Fault.FREEZE: Action(lambda a: self._freeze(True), lambda: self._freeze(False)),
                Fault.RETURN_CODE: Action(self._force, self._free, frozenset({"code", "rpc"})),
                Fault.REBOOT: Action(self._reboot, takes=frozenset({"boot_s", "serial"})),
            }
        )

    def offers(self) -> frozenset[Fault]:
        """The faults of the wires and of the instrument."""
        return self._actions.offers() | self._tracker.offers()

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for what it does not take."""
        owner = self._actions if fault in self._actions.offers() else self._tracker
        owner.inject(fault, arguments)

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.end_all()
        self._wires.faults.lose = 0
        self._tracker.clear()

    def close(self) -> None:
        """Forget timers and reboots on their way."""
        self._actions.forget_timers()
        for task in self._tasks:
            task.cancel()

    def _refuse(self, arguments: Arguments) -> None:
        self._wires.refuse()
        self._wires.cut()

    def _lose(self, arguments: Arguments) -> None:
        self._wires.faults.lose = int(number(arguments, "count", 1, low=1))

    def _freeze(self, on: bool) -> None:
        self._wires.instrument.edm.freeze(on)

    def _force(self, arguments: Arguments) -> None:
        code = int(number(arguments, "code", 4, low=1))
        if code > _LARGEST_CODE:
            raise error("ARGUMENT_INVALID", f"code={code} is not a return code")
        self._wires.instrument.forced[int(number(arguments, "rpc", EVERY, low=EVERY))] = code

    def _free(self) -> None:
        self._wires.instrument.forced.clear()

    def _reboot(self, arguments: Arguments) -> None:
        serial = str(arguments.get("serial", self._wires.instrument.serial))
        if not serial.isdigit() or not serial.startswith("9999"):
            raise error(
                "ARGUMENT_INVALID", f"serial={serial!r}: twin serials are digits that begin with 9999"
            )
        if self._rebooting is not None:
            self._rebooting.cancel()
        self._rebooting = self._spawn(self._wires.reboot(number(arguments, "boot_s", 2.0), serial))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
