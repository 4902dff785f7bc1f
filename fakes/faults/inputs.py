"""The faults of the inputs themselves by their names in the vocabulary."""

from collections.abc import Callable, Mapping
from typing import Any

from cell.errors import error
from fakes.faults.actions import Action, Actions
from fakes.faults.vocabulary import Fault, number
from fakes.world.beams.input_module import InputModule


class InputFaults:
    """Injects faults into an input module at ``now``; lasting ones end after ``for_s`` or with ``clear``."""

    def __init__(self, inputs: InputModule, now: Callable[[], float]) -> None:
        self._inputs, self._now = inputs, now
        self._actions = Actions(
            {
                Fault.STUCK: Action(
                    self._stick, lambda: inputs.stick(now(), None), frozenset({"input", "level"})
                ),
                Fault.BOUNCE: Action(
                    self._bounce, lambda: inputs.bounce(now(), inputs.truth.bounce_s), frozenset({"s"})
                ),
                Fault.WRAP: Action(self._wrap, takes=frozenset({"before"})),
                Fault.FREEZE: Action(
                    lambda a: inputs.freeze(now(), True), lambda: inputs.freeze(now(), False)
                ),
            }
        )

    def offers(self) -> frozenset[Fault]:
        """The faults that inputs can show."""
        return self._actions.offers()

    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for what it does not take.

        ``stuck`` takes ``input`` (all without it) and ``level`` (on or off: of the contact), ``bounce`` takes
        ``s``, ``wrap`` takes ``before``: so many counts are left.
        """
        self._actions.inject(fault, arguments)

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.forget_timers()
        self._inputs.clear(self._now())

    def close(self) -> None:
        """Let nothing end by itself any more."""
        self._actions.forget_timers()

    def _stick(self, arguments: Mapping[str, Any]) -> None:
        name, level = arguments.get("input"), arguments.get("level", "on")
        if name is not None and name not in self._inputs.truth.inputs:
            known = ", ".join(self._inputs.truth.inputs)
            raise error("ARGUMENT_INVALID", f"input={name!r} is not an input; there are {known}")
        if level not in ("on", "off"):
            raise error("ARGUMENT_INVALID", f"level={level!r} is neither on nor off")
        self._inputs.stick(self._now(), level == "on", name)

    def _bounce(self, arguments: Mapping[str, Any]) -> None:
        self._inputs.bounce(self._now(), number(arguments, "s", 0.003))

    def _wrap(self, arguments: Mapping[str, Any]) -> None:
        left = int(number(arguments, "before", 3, low=1))
        self._inputs.preset(self._now(), self._inputs.MODULUS - left)
