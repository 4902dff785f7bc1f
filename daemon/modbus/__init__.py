"""The Modbus server for PLCs and panels, made from one register table."""

from daemon.modbus.command import Command
from daemon.modbus.face import ModbusFace
from daemon.modbus.table import register_table

__all__ = ["Command", "ModbusFace", "register_table"]
