"""Digital inputs on a Modbus module: TCP, TLS or a serial line."""

from drivers.modbus_inputs.config import InputsConfig
from drivers.modbus_inputs.inputs import ModbusInputs

__all__ = ["InputsConfig", "ModbusInputs"]
