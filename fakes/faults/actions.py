"""Faults as a table of actions: what begins each, what ends it when it lasts, what arguments it takes."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cell.errors import error
from fakes.faults.vocabulary import Fault, number

Arguments = Mapping[str, Any]


@dataclass(frozen=True)
class Action:
    """How a fault begins, how it ends when it lasts, and which arguments it takes besides ``for_s``."""

    begin: Callable[[Arguments], object]
    end: Callable[[], object] | None = None
    takes: frozenset[str] = frozenset()


class Actions:
    """Begins faults and ends them: lasting ones after ``for_s`` seconds, or all with :meth:`end_all`."""

    def __init__(self, table: Mapping[Fault, Action]) -> None:
        self._table = dict(table)
        self._timers: dict[Fault, asyncio.TimerHandle] = {}

    def offers(self) -> frozenset[Fault]:
        return frozenset(self._table)

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for what it does not take, and then nothing has begun."""
        action = self._table[fault]
        takes = action.takes | ({"for_s"} if action.end is not None else frozenset())
        unknown = set(arguments) - takes
        if unknown:
            wrong, right = ", ".join(sorted(unknown)), ", ".join(sorted(takes)) or "nothing"
            raise error("ARGUMENT_INVALID", f"{fault} does not take {wrong}; it takes {right}")
        duration = number(arguments, "for_s", 0.0)
        action.begin(arguments)
        self._forget(fault)  # the end that an earlier injection had set is not this one's
        if duration > 0 and action.end is not None:
            self._timers[fault] = asyncio.get_running_loop().call_later(duration, action.end)

    def end_all(self) -> None:
        """End every fault that lasts."""
        self.forget_timers()
        for action in self._table.values():
            if action.end is not None:
                action.end()

    def forget_timers(self) -> None:
        """Let nothing end by itself any more."""
        for fault in tuple(self._timers):
            self._forget(fault)

    def _forget(self, fault: Fault) -> None:
        timer = self._timers.pop(fault, None)
        if timer is not None:
            timer.cancel()


def switch(owner: object, name: str, on: Any = True, off: Any = False) -> Action:
    """A fault that lasts and is an attribute of ``owner``."""
    return Action(lambda a: setattr(owner, name, on), lambda: setattr(owner, name, off))


def amount(owner: object, name: str, default: float) -> Action:
    """A fault that lasts and is a number of seconds, argument ``s``."""
    return Action(
        lambda a: setattr(owner, name, number(a, "s", default)),
        lambda: setattr(owner, name, 0.0),
        frozenset({"s"}),
    )
