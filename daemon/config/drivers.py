"""Device drivers by name. A driver is imported only when a cell names it."""

import importlib
from collections.abc import Mapping
from difflib import get_close_matches
from importlib.metadata import entry_points
from typing import Any

from pydantic import BaseModel

GROUP = "cellward.drivers"

DRIVERS: dict[str, str] = {
    "ur": "drivers.ur:UrArm",
    "oak": "drivers.oak:OakCamera",
    "modbus-inputs": "drivers.modbus_inputs:ModbusInputs",
    "arm-inputs": "drivers.ur.inputs:ArmInputs",
    "geocom": "drivers.tracker:GeocomTracker",
    "line-stream": "drivers.tracker:LineStreamTracker",
    "line-points": "drivers.tracker:LinePointTracker",
    "observed-arm": "drivers.observed_arm:ObservedArmReader",
    "arm-gripper": "drivers.ur.gripper:ArmGripper",
    "modbus-gripper": "drivers.grippers:ModbusGripper",
    "robotiq": "drivers.grippers:RobotiqGripper",
    "canopen-encoder": "drivers.can_encoder:CanopenEncoder",
    "raw-can-encoder": "drivers.can_encoder:RawCanEncoder",
}


def bindings(driver: Any) -> Mapping[str, type]:
    """The keys of a driver's config that name another device, with the Protocol that this one must have.

    Such a driver has ``BINDS`` and is given the devices by ``bind(key=device, ...)`` before it is opened.
    """
    found: Mapping[str, type] = getattr(driver, "BINDS", {})
    return found


def installed_drivers() -> dict[str, str]:
    """``package.module:Class`` of each driver that an installed package offers, by its short name."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP) if entry.name not in DRIVERS}


def driver_class(name: str, drivers: Mapping[str, str] = DRIVERS) -> Any:
    """The class behind a short name, or behind ``package.module:Class``.

    ``LookupError`` with a sentence when there is no such driver, when it cannot be imported, or when the
    class carries no ``Config`` model.
    """
    target = drivers.get(name, name)
    if ":" not in target:  # only then: to look through all installed packages takes milliseconds
        target = installed_drivers().get(name, name)
    module, colon, attribute = target.partition(":")
    if not colon:
        known = sorted({*drivers, *installed_drivers()})
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"there is {', '.join(known)}"
        raise LookupError(f"there is no driver '{name}', {hint}")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except Exception as exc:  # whatever a driver's package does while it is imported
        raise LookupError(f"driver '{name}' cannot be loaded: {str(exc) or type(exc).__name__}") from exc
    if not (isinstance(getattr(found, "Config", None), type) and issubclass(found.Config, BaseModel)):
        raise LookupError(f"driver '{name}' has no Config model, so it is no driver")
    return found
