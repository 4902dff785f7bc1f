"""Which kind of device a driver is: its class lists the Protocols of ``cell.devices`` in ``PLAYS``."""

from typing import TypeVar, cast

from cell.devices import Device
from cell.errors import error

D = TypeVar("D", bound=Device)


def plays(driver: object, protocol: type) -> bool:
    """Whether a driver's class, or a device of it, says that it is what ``protocol`` describes."""
    return protocol in getattr(driver, "PLAYS", ())


def as_kind(device: Device, protocol: type[D]) -> D:
    """``device`` as what its class says it is; ``INTERNAL`` for another kind, which no valid cell has."""
    if not plays(device, protocol):
        raise error("INTERNAL", f"the device '{device.name}' is no {protocol.__name__}")
    return cast(D, device)
