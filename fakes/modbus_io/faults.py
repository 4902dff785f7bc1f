"""A Modbus device on the twin's switchboard: faults of its wires, and those behind them passed on."""

from fakes.faults.actions import Arguments
from fakes.faults.vocabulary import Fault, Faulty
from fakes.faults.wire import WireFaults
from fakes.modbus_io.module import Module
from fakes.modbus_io.wires import ModuleWires


class ModuleFaults(WireFaults):
    """``inputs`` is what shows the faults of what the device reads (stuck, bounce, ...)."""

    def __init__(self, wires: ModuleWires, inputs: Faulty | None = None) -> None:
        self._wires = wires
        module = wires.service.module
        super().__init__(wires, wires.service.faults, lambda: str(module.identity.serial), behind=inputs)

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``ARGUMENT_INVALID`` for what it does not take."""
        super().inject(fault, arguments)
        module = self._wires.service.module
        if fault == Fault.WRAP and isinstance(module, Module):
            module.follow_inputs()  # a clear that came before would move the wrap elsewhere
