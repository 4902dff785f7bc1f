"""The Modbus server for PLCs and panels, made from one register table."""

from daemon.modbus.command import Command, CommandChannel
from daemon.modbus.face import ModbusFace
from daemon.modbus.table import Register, RegisterTable, register_table

__all__ = ["Command", "CommandChannel", "ModbusFace", "Register", "RegisterTable", "register_table"]
