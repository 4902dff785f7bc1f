"""Devices from their sections of the configuration."""

from collections.abc import Mapping
from typing import Any

from cell.clock import Clock
from cell.devices import Device
from daemon.config import CellConfig, DeviceSection, bindings, driver_class
from daemon.health import Beats
from daemon.supervisor import ExpectedIdentity, SupervisedDevice


def supervised_devices(config: CellConfig, clock: Clock, beats: Beats) -> list[SupervisedDevice]:
    """One supervised device for each ``[device.NAME]``, not yet connected."""
    made = []
    for name, section in config.device.items():
        driver = driver_class(section.driver)
        own = driver.Config.model_validate(section.model_dump(exclude=set(DeviceSection.model_fields)))
        device: Device = driver(name, own, clock)
        expect = ExpectedIdentity(config.cell.twin, getattr(section, "expect_serial", None))
        made.append(SupervisedDevice(device, expect, clock, beats))
    _bind(config, {entry.device.name: entry.device for entry in made})
    return made


def bound_to(config: CellConfig, name: str) -> dict[str, str]:
    """The devices that ``[device.NAME]`` names to stand on, by the key that names them."""
    section = config.device[name]
    return {key: getattr(section, key) for key in bindings(driver_class(section.driver))}


def _bind(config: CellConfig, devices: Mapping[str, Device]) -> None:
    """Give each device those that its section names."""
    for name in config.device:
        if others := bound_to(config, name):
            binder: Any = devices[name]
            binder.bind(**{key: devices[other] for key, other in others.items()})
