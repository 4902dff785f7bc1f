"""Grippers with a link of their own: Robotiq's, and valves on the outputs of a Modbus module."""

from drivers.grippers.modbus_outputs import ModbusGripper
from drivers.grippers.robotiq import RobotiqGripper

__all__ = ["ModbusGripper", "RobotiqGripper"]
