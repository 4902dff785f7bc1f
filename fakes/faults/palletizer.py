"""What the observed arm and its program do wrong, by the names of the vocabulary."""

from collections.abc import Callable, Mapping
from typing import Any

from cell.errors import error
from fakes.faults.actions import Action, Actions
from fakes.faults.vocabulary import Fault, number
from fakes.world.palletizer.observed import ObservedPalletizer


class ObservedFaults:
    """Injects faults into the arm at ``now``; lasting ones end after ``for_s`` or with ``clear``."""

    def __init__(self, arm: ObservedPalletizer, now: Callable[[], float]) -> None:
        self._arm, self._now = arm, now
        self._actions = Actions(
            {
                Fault.STUCK: Action(self._stick, lambda: arm.free(now()), frozenset({"joint"})),
                Fault.UNASKED_MOVE: Action(self._jog, takes=frozenset({"rad"})),
                Fault.SKIP_POSE: Action(lambda a: arm.skip_next()),
                Fault.WRONG_ORDER: Action(lambda a: arm.disorder_next()),
            }
        )

    def offers(self) -> frozenset[Fault]:
        """The faults that the arm can show."""
        return self._actions.offers()

    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        """Begin ``fault``; ``stuck`` takes ``joint`` (1 ..., all without it), ``unasked-move`` ``rad``."""
        self._actions.inject(fault, arguments)

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.forget_timers()
        self._arm.clear(self._now())

    def close(self) -> None:
        """Let nothing end by itself any more."""
        self._actions.forget_timers()

    def _stick(self, arguments: Mapping[str, Any]) -> None:
        joint = int(number(arguments, "joint", 0))
        if joint > self._arm.axes:
            raise error("ARGUMENT_INVALID", f"joint={joint}: the arm has joints 1 to {self._arm.axes}")
        self._arm.stick(self._now(), joint or None)

    def _jog(self, arguments: Mapping[str, Any]) -> None:
        self._arm.jog(self._now(), number(arguments, "rad", 0.01, low=-1.0))
