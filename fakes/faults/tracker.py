"""The faults of a tracker itself by their names in the vocabulary."""

from collections.abc import Callable, Mapping
from typing import Any

from cell.errors import error
from fakes.faults.actions import Action, Actions
from fakes.faults.vocabulary import Fault, number
from fakes.world.tracker.tracker import Tracker
from fakes.world.tracker.visibility import BROKEN, TURNED_AWAY

_FAR = -1e6


class TrackerFaults:
    """Injects faults into a tracker at ``now``; lasting ones end after ``for_s`` or with ``clear``.

    A stand that was pushed and a constant that was set stay as they are.
    """

    def __init__(self, tracker: Tracker, now: Callable[[], float]) -> None:
        self._tracker, self._now = tracker, now
        one = frozenset({"reflector"})
        self._actions = Actions(
            {
                Fault.BEAM_BREAK: Action(lambda a: self._hide(BROKEN, a), lambda: self._show(BROKEN), one),
                Fault.OUT_OF_VIEW: Action(
                    lambda a: self._hide(TURNED_AWAY, a), lambda: self._show(TURNED_AWAY), one
                ),
                Fault.STAND_MOVED: Action(self._push, takes=frozenset({"dx", "dy", "dz", "rx", "ry", "rz"})),
                Fault.WRONG_CONSTANT: Action(self._set_constant, takes=frozenset({"m"})),
                Fault.VIBRATION: Action(self._shake, self._rest, frozenset({"m", "hz"})),
                Fault.DOUBTFUL: Action(lambda a: self._doubt(True), lambda: self._doubt(False)),
            }
        )

    def offers(self) -> frozenset[Fault]:
        """The faults that a tracker can show."""
        return self._actions.offers()

    def inject(self, fault: Fault, arguments: Mapping[str, Any]) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for what it does not take.

        ``beam-break`` and ``out-of-view`` take ``reflector`` (all without it), ``stand-moved`` takes ``dx``
        .. ``rz`` (m and rad in the base; 1 mm along x without any), ``wrong-constant`` takes ``m``, the new
        constant, ``vibration`` takes ``m``, its amplitude, and ``hz``.
        """
        self._actions.inject(fault, arguments)

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.end_all()

    def close(self) -> None:
        """Let nothing end by itself any more."""
        self._actions.forget_timers()

    def _hide(self, why: str, arguments: Mapping[str, Any]) -> None:
        name = arguments.get("reflector")
        if name is not None and name not in self._tracker.reflectors:
            known = ", ".join(self._tracker.reflectors)
            raise error("ARGUMENT_INVALID", f"reflector={name!r} does not exist; there are {known}")
        self._tracker.visibility.hinder(why, self._now(), name)

    def _show(self, why: str) -> None:
        self._tracker.visibility.free(self._now(), why)

    def _push(self, arguments: Mapping[str, Any]) -> None:
        shift = [number(arguments, key, 0.0, low=_FAR) for key in ("dx", "dy", "dz")]
        turn = [number(arguments, key, 0.0, low=_FAR) for key in ("rx", "ry", "rz")]
        self._tracker.stand.move(self._now(), shift if arguments else [0.001, 0.0, 0.0], turn)

    def _set_constant(self, arguments: Mapping[str, Any]) -> None:
        self._tracker.constant_m = number(arguments, "m", 0.0169, low=-0.1)

    def _shake(self, arguments: Mapping[str, Any]) -> None:
        self._tracker.shake = number(arguments, "m", 0.0003), number(arguments, "hz", 7.0)

    def _rest(self) -> None:
        self._tracker.shake = (0.0, 0.0)

    def _doubt(self, on: bool) -> None:
        self._tracker.doubtful = on
