"""Where a tracker is: a TCP server, a serial line, or datagrams."""

from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

from drivers.serial_url import SerialLine, parse_serial


@dataclass(frozen=True)
class NetAddress:
    """A TCP server that is connected to, or an address of UDP."""

    scheme: Literal["tcp", "udp"]
    host: str
    port: int


TrackerAddress = NetAddress | SerialLine


def parse_address(url: str, *, udp: bool = False) -> TrackerAddress:
    """``ValueError`` with a sentence for anything that is no address; ``udp`` allows datagrams."""
    scheme = urlsplit(url).scheme
    if scheme == "serial":
        return parse_serial(url)
    if scheme == "tcp":
        return NetAddress("tcp", *_host_port(url))
    if udp and scheme == "udp":
        return NetAddress("udp", *_host_port(url))
    known = "tcp://, serial:// or udp://" if udp else "tcp:// or serial://"
    raise ValueError(f"url '{url}' should begin with {known}")


def _host_port(url: str) -> tuple[str, int]:
    parts = urlsplit(url)
    if parts.query or parts.path.strip("/") or not parts.hostname or parts.username is not None:
        raise ValueError(f"url '{url}' should be {parts.scheme}://host:port")
    try:
        port = parts.port
    except ValueError:
        port = None
    if not port:
        raise ValueError(f"url '{url}' needs a port from 1 to 65535; it is set on the instrument")
    return parts.hostname, port
