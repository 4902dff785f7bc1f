"""Where a CAN bus is reached: the text of the key ``bus``."""

import re
from dataclasses import dataclass
from typing import Literal

SLCAN_BIT_RATES = (10_000, 20_000, 50_000, 83_300, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000)
SOCKETCAND_PORT = 29536

_FORMS = {
    "socketcan": (re.compile(r"(?P<channel>[\w.-]{1,15})"), "socketcan:can0"),
    "slcan": (
        re.compile(r"(?P<channel>/[^@?]+)@(?P<bit_rate>\d{1,8})(?:\?baudrate=(?P<baudrate>\d{1,8}))?"),
        "slcan:/dev/ttyACM0@250000, the bit rate of the bus behind the @",
    ),
    "socketcand": (
        re.compile(
            r"(?P<host>\[[0-9a-fA-F:.]+\]|[^:/\[\]]+)(?::(?P<port>\d{1,5}))?/(?P<channel>[\w.-]{1,15})"
        ),
        "socketcand:host:29536/can0",
    ),
}


@dataclass(frozen=True)
class BusAddress:
    """A parsed ``bus``; ``channel`` is the interface's name, or the path of a serial adapter."""

    interface: Literal["socketcan", "slcan", "socketcand"]
    channel: str
    host: str = ""
    port: int = SOCKETCAND_PORT
    bit_rate: int = 0  # of the bus; socketcan and socketcand have it from the system
    baudrate: int = 115200  # of the serial line; USB adapters do not care


def parse_bus(bus: str) -> BusAddress:
    """``ValueError`` with a sentence for anything that is not the address of a bus."""
    interface, _, rest = bus.partition(":")
    if interface not in _FORMS:
        raise ValueError(f"bus '{bus}' should begin with socketcan:, slcan: or socketcand:")
    form, example = _FORMS[interface]
    found = form.fullmatch(rest)
    if found is None:
        raise ValueError(f"bus '{bus}' should be like {example}")
    parts = found.groupdict()
    if interface == "socketcan":
        return BusAddress("socketcan", parts["channel"])
    if interface == "slcan":
        rate = int(parts["bit_rate"])
        if rate not in SLCAN_BIT_RATES:
            known = ", ".join(map(str, SLCAN_BIT_RATES))
            raise ValueError(f"bus '{bus}': serial adapters have no bit rate {rate}; they have {known}")
        return BusAddress("slcan", parts["channel"], bit_rate=rate, baudrate=int(parts["baudrate"] or 115200))
    port = int(parts["port"] or SOCKETCAND_PORT)
    if not 1 <= port <= 65535:
        raise ValueError(f"bus '{bus}' has a port that is no number from 1 to 65535")
    return BusAddress("socketcand", parts["channel"], parts["host"].strip("[]"), port)
