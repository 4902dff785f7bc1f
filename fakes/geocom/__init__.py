"""A total station that speaks GeoCOM in ASCII, on TCP and on a pseudo-terminal."""

from fakes.geocom.conversation import LineFaults
from fakes.geocom.faults import StationFaults
from fakes.geocom.instrument import Instrument
from fakes.geocom.wires import StationWires

__all__ = ["Instrument", "LineFaults", "StationFaults", "StationWires"]
