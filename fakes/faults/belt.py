"""The faults of a belt and of the encoder itself by their names in the vocabulary, whatever the wire."""

from collections.abc import Callable, Mapping
from typing import Any

from cell.errors import error
from fakes.faults.actions import Action, Actions
from fakes.faults.vocabulary import MAX_ARGUMENT, Fault, number
from fakes.world.belt.encoder import BeltEncoder


class BeltFaults:
    """Injects faults at ``now``; lasting ones end after ``for_s`` or with ``clear``.

    ``slip`` takes ``m`` (either way) and ``s``, ``wrap`` takes ``before``, ``belt-stop`` and
    ``belt-reverse`` take ``accel``.
    """

    def __init__(self, encoder: BeltEncoder, now: Callable[[], float]) -> None:
        self._encoder, self._belt, self._now = encoder, encoder.belt, now
        self._ordered = False
        self._actions = Actions(
            {
                Fault.SLIP: Action(self._slip, takes=frozenset({"m", "s"})),
                Fault.STUCK: Action(
                    lambda a: encoder.stick(now(), True), lambda: encoder.stick(now(), False)
                ),
                Fault.FREEZE: Action(
                    lambda a: encoder.freeze(now(), True), lambda: encoder.freeze(now(), False)
                ),
                Fault.WRAP: Action(
                    lambda a: encoder.wrap(now(), int(number(a, "before", 20, low=1))),
                    takes=frozenset({"before"}),
                ),
                Fault.BELT_STOP: Action(lambda a: self._order(a, 0.0), self._resume, frozenset({"accel"})),
                Fault.BELT_REVERSE: Action(
                    lambda a: self._order(a, -self._belt.truth.profile[0].speed_m_s),
                    self._resume,
                    frozenset({"accel"}),
                ),
            }
        )

    def offers(self) -> frozenset[Fault]:
        """The faults that a belt and its encoder can show."""
        return self._actions.offers()

    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for what it does not take."""
        self._actions.inject(fault, arguments)

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.end_all()

    def close(self) -> None:
        """Let nothing end by itself any more."""
        self._actions.forget_timers()

    def _slip(self, arguments: Mapping[str, Any]) -> None:
        distance = number(arguments, "m", 0.005, low=-MAX_ARGUMENT)
        if abs(distance) > 1.0:
            raise error("ARGUMENT_INVALID", f"m={distance:g}: a slip is a metre at most")
        self._encoder.slip(self._now(), distance, number(arguments, "s", 0.05))

    def _order(self, arguments: Mapping[str, Any], speed: float) -> None:
        self._belt.run(self._now(), speed, number(arguments, "accel", 1.0, low=0.01))
        self._ordered = True

    def _resume(self) -> None:
        if self._ordered:
            self._ordered = False
            self._belt.resume(self._now())
