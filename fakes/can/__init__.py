"""A belt encoder on CAN: a CiA 406 node behind a serial adapter (slcan) and a gateway (socketcand)."""

from fakes.can.faults import CanFaults
from fakes.can.wires import CanWires

__all__ = ["CanFaults", "CanWires"]
