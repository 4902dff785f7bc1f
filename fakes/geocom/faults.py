"""The station on the twin's switchboard: faults of its wires, and those of the tracker passed on."""

from cell.errors import error
from fakes.faults.actions import Action, Arguments
from fakes.faults.vocabulary import Fault, Faulty, number
from fakes.faults.wire import WireFaults
from fakes.geocom.instrument import EVERY
from fakes.geocom.wires import StationWires

_LARGEST_CODE = 65535


class StationFaults(WireFaults):
    """``tracker`` is what shows the faults of the instrument itself. ``return-code`` takes ``code`` and
    ``rpc`` (every procedure without it), ``gap`` takes ``count``, the answers that get lost."""

    def __init__(self, wires: StationWires, tracker: Faulty) -> None:
        self._wires = wires
        freeze = wires.instrument.edm.freeze
        own = {
            Fault.GAP: Action(self._lose, takes=frozenset({"count"})),
            Fault.FREEZE: Action(lambda a: freeze(True), lambda: freeze(False)),
            Fault.RETURN_CODE: Action(self._force, wires.instrument.forced.clear, frozenset({"code", "rpc"})),
        }
        super().__init__(wires, wires.faults, lambda: wires.instrument.serial, own, tracker)

    def clear(self) -> None:
        """End every fault that lasts."""
        super().clear()
        self._wires.faults.lose = 0

    def _lose(self, arguments: Arguments) -> None:
        self._wires.faults.lose = int(number(arguments, "count", 1, low=1))

    def _force(self, arguments: Arguments) -> None:
        code = int(number(arguments, "code", 4, low=1))
        if code > _LARGEST_CODE:
            raise error("ARGUMENT_INVALID", f"code={code} is not a return code")
        self._wires.instrument.forced[int(number(arguments, "rpc", EVERY, low=EVERY))] = code
