"""A digital-input module on real wires: Modbus over TCP, over TLS and as RTU on a pseudo-terminal."""

from fakes.modbus_io.faults import ModuleFaults
from fakes.modbus_io.maps import register_map
from fakes.modbus_io.module import Identity, Module
from fakes.modbus_io.service import Pace
from fakes.modbus_io.wires import ModuleWires
from fakes.wire.listening import TcpPlace

__all__ = [
    "Identity",
    "Module",
    "ModuleFaults",
    "ModuleWires",
    "Pace",
    "TcpPlace",
    "register_map",
]
