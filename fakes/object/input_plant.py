"""The input module of the object face as a thing: the world's module, and what can go wrong with its link."""

from collections.abc import Callable

from cell.clock import Clock
from fakes.faults.inputs import InputFaults
from fakes.faults.vocabulary import Fault
from fakes.object._plant import Plant
from fakes.world.beams.input_module import InputModule


class InputPlant(Plant):
    """The module at the far end of the cable, with the faults of its inputs beside those of every link."""

    def __init__(self, inputs: InputModule, clock: Clock) -> None:
        super().__init__("beams", clock, inputs.truth.serial)
        self.inputs = inputs
        self._input_faults = InputFaults(inputs, clock.now)
        self.faults |= {fault.value: self._named(fault) for fault in self._input_faults.offers()}

    def clear(self) -> None:
        """Free the contacts, and end the faults of the link."""
        self.settle_past()
        self._input_faults.clear()
        super().clear()

    def _named(self, fault: Fault) -> Callable[..., None]:
        def begin(duration_s: float | None = None, **arguments: object) -> None:
            if duration_s is not None:
                arguments["for_s"] = duration_s
            self._input_faults.inject(fault, arguments)

        return begin

    def _reboot(self, serial: str | None = None, boot_s: float = 1.0) -> None:
        self.inputs.reboot(self.clock.now())
        super()._reboot(serial, boot_s)
