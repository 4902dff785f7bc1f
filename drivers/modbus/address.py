"""Where a Modbus device is: ``tcp://host:port``, ``tls://host:port`` or a serial line."""

from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

from drivers.serial_url import parse_serial

_PORTS = {"tcp": 502, "tls": 802}


@dataclass(frozen=True)
class ModbusAddress:
    """A parsed ``url``: ``host`` and ``port`` of tcp and tls, or ``host`` as the path of a serial line."""

    scheme: Literal["tcp", "tls", "rtu"]
    host: str
    port: int = 0
    baudrate: int = 115200
    parity: str = "N"
    stopbits: int = 1


def parse_url(url: str) -> ModbusAddress:
    """``ValueError`` with a sentence for anything that is not the address of a module."""
    parts = urlsplit(url)
    if parts.scheme == "rtu":
        line = parse_serial(url)
        return ModbusAddress("rtu", line.path, 0, line.baudrate, line.parity, line.stopbits)
    if parts.scheme not in ("tcp", "tls"):
        raise ValueError(f"url '{url}' should begin with tcp://, tls:// or rtu://")
    if parts.query or parts.path.strip("/") or not parts.hostname or parts.username is not None:
        raise ValueError(f"url '{url}' should be {parts.scheme}://host:port")
    try:
        port = parts.port or _PORTS[parts.scheme]
    except ValueError:
        raise ValueError(f"url '{url}' has a port that is no number from 1 to 65535") from None
    return ModbusAddress("tcp" if parts.scheme == "tcp" else "tls", parts.hostname, port)
