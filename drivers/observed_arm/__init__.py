"""An arm that is read and asked, never moved: joints over Modbus registers, or from a file."""

from drivers.observed_arm.config import ObservedArmConfig
from drivers.observed_arm.reader import ObservedArmReader

__all__ = ["ObservedArmConfig", "ObservedArmReader"]
