"""The input module of the object face as a thing: the world's module, and what can go wrong with its link."""

from cell.clock import Clock
from fakes.faults.inputs import InputFaults
from fakes.object._plant import FaultyPlant
from fakes.world.beams.input_module import InputModule


class InputPlant(FaultyPlant):
    """The module at the far end of the cable, with the faults of its inputs beside those of every link."""

    def __init__(self, inputs: InputModule, clock: Clock) -> None:
        super().__init__("beams", clock, inputs.truth.serial, InputFaults(inputs, clock.now))
        self.inputs = inputs

    def _reboot(self, serial: str | None = None, boot_s: float = 1.0) -> None:
        self.inputs.reboot(self.clock.now())
        super()._reboot(serial, boot_s)
