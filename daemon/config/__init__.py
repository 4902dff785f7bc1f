"""``cell.toml``: read, checked in one go with places and hints, and never written by the program."""

from daemon.config.drivers import DRIVERS, bindings, driver_class
from daemon.config.faces import ModbusSection
from daemon.config.findings import ConfigInvalid
from daemon.config.load import CellConfig, load_config
from daemon.config.models import DeviceSection
from daemon.config.schema import init_text, json_schema

__all__ = [
    "DRIVERS",
    "CellConfig",
    "ConfigInvalid",
    "DeviceSection",
    "ModbusSection",
    "bindings",
    "driver_class",
    "init_text",
    "json_schema",
    "load_config",
]
