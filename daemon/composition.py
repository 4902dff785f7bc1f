"""Devices from their sections of the configuration."""

from cell.clock import Clock
from cell.devices import Device
from daemon.config import CellConfig, driver_class
from daemon.health import Beats
from daemon.supervisor import Expectation, SupervisedDevice


def supervised_devices(config: CellConfig, clock: Clock, beats: Beats) -> list[SupervisedDevice]:
    """One supervised device for each ``[device.NAME]``, not yet connected."""
    made = []
    for name, section in config.device.items():
        driver = driver_class(section.driver)
        own = driver.Config.model_validate(section.model_dump(exclude={"driver"}))
        device: Device = driver(name, own, clock)
        expect = Expectation(config.cell.twin, getattr(section, "expect_serial", None))
        made.append(SupervisedDevice(device, expect, clock, beats))
    return made
