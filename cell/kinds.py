"""Which kind of device a driver is: its class lists the Protocols of ``cell.devices`` in ``PLAYS``."""

from inspect import isfunction
from typing import TypeVar, cast

from cell.devices import Device, Gripper
from cell.errors import error

D = TypeVar("D", bound=Device)


def plays(driver: object, protocol: type) -> bool:
    """Whether a driver's class, or a device of it, says that it is what ``protocol`` describes."""
    return protocol in getattr(driver, "PLAYS", ())


def lacking(driver: type, protocol: type) -> list[str]:
    """What ``protocol`` asks that a driver's class does not have.

    No type check of ours has seen the driver of another package. Looked for are methods,
    and whether a gripper ``confirms``: other attributes may be made with the device.
    """
    asked = {
        name
        for kind in protocol.__mro__
        if getattr(kind, "_is_protocol", False)
        for name, member in vars(kind).items()
        if not name.startswith("_") and (isfunction(member) or (kind is Gripper and name == "confirms"))
    }
    return sorted(name for name in asked if not hasattr(driver, name))


def as_kind(device: Device, protocol: type[D]) -> D:
    """``device`` as what its class says it is; ``INTERNAL`` for another kind, which no valid cell has."""
    if not plays(device, protocol):
        raise error("INTERNAL", f"the device '{device.name}' is no {protocol.__name__}")
    return cast(D, device)
