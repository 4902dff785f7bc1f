"""The networks that the unit lets the daemon reach, told by the addresses in ``cell.toml``."""

import ipaddress
from collections.abc import Iterable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

from cell.errors import error
from daemon.config import CellConfig
from daemon.service.places import CONFIG, NETWORK, OF_ADMINISTRATOR, UNIT_OF_PACKAGE

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
_PREFIX = {4: 24, 6: 64}  # what a cell's network has unless somebody says otherwise


def addresses(config: CellConfig) -> Iterator[tuple[str, str]]:
    """Key and host of everything that the daemon talks to over a network, or that talks to it."""
    for name, section in config.device.items():
        raw = section.model_dump(mode="json")
        if isinstance(raw.get("host"), str):
            yield f"device.{name}.host", raw["host"]
        for key in ("url", "source", "bus"):
            value = raw.get(key)
            if isinstance(value, str) and "://" in value and (host := urlsplit(value).hostname):
                yield f"device.{name}.{key}", host
    if config.mqtt.enabled:
        yield "mqtt.host", config.mqtt.host
    for name, server in (("modbus", config.modbus), ("http", config.http)):
        if server.enabled:
            yield f"{name}.bind", server.bind.rpartition(":")[0].strip("[]")


def subnets(config: CellConfig, allowed: Iterable[str] = ()) -> list[Network]:
    """The networks of the cell, without this computer itself: of each address the /24 (IPv6: the /64).

    ``allow_clients`` of ``[modbus]`` and ``allowed`` count as they are written. ``ARGUMENT_INVALID`` for a
    host name, and for a server on every address whose clients nobody named: their networks cannot be known.
    """
    extra = [_network(text) for text in allowed]
    clients = [_network(text) for text in config.modbus.allow_clients]
    found = {*extra, *(clients if config.modbus.enabled else ())}
    for key, host in addresses(config):
        if host == "localhost":
            continue
        try:
            address = ipaddress.ip_address(host)
        except ValueError:
            if not extra:
                raise error(
                    "ARGUMENT_INVALID",
                    f"{key} = '{host}' is a name, and the unit permits addresses: write the address into the "
                    "configuration, or give its network with --allow",
                ) from None
            continue
        if address.is_unspecified:
            if not extra and not (key == "modbus.bind" and clients):
                raise error(
                    "ARGUMENT_INVALID",
                    f"{key} = '{host}' serves every address: say with --allow which networks may reach it",
                )
        elif not address.is_loopback:
            found.add(ipaddress.ip_network(f"{address}/{_PREFIX[address.version]}", strict=False))
    outside = [network for network in found if not network.is_loopback]
    return sorted(_merged(outside), key=lambda n: (n.version, int(n.network_address), n.prefixlen))


def drop_in(networks: Iterable[Network]) -> str:
    """The drop-in of the unit that permits these networks beside this computer."""
    permitted = " ".join(["localhost", *map(str, networks)])
    return (
        f"# Made by 'cellward install' from /{CONFIG}. After a change of addresses: sudo cellward install\n"
        f"[Service]\nIPAddressAllow=\nIPAddressAllow={permitted}\n"
    )


def not_permitted(config: CellConfig, root: Path = Path("/")) -> list[str]:
    """A sentence for each address of ``config`` that the installed unit keeps the daemon from."""
    if not any(
        (root / unit).is_file() for unit in (UNIT_OF_PACKAGE, OF_ADMINISTRATOR.units / "cellward.service")
    ):
        return []
    try:
        lines = (root / NETWORK).read_text("utf-8").splitlines()
    except OSError:
        lines = []
    words = [
        w for line in lines if line.startswith("IPAddressAllow=") for w in line.partition("=")[2].split()
    ]
    permitted = [_network(word) for word in words if word != "localhost"]
    if "any" in words:
        return []
    said = []
    for key, host in addresses(config):
        try:
            address = ipaddress.ip_address(host)
        except ValueError:
            continue
        outside = not any(address in network for network in permitted if network.version == address.version)
        if outside and not address.is_loopback and not address.is_unspecified:
            said.append(f"{key}: the service may not reach {host}; 'sudo cellward install' permits it")
    return said


def _network(text: str) -> Network:
    try:
        return ipaddress.ip_network(text, strict=False)
    except ValueError:
        raise error("ARGUMENT_INVALID", f"'{text}' is no network; write it as 192.168.20.0/24") from None


def _merged(networks: Iterable[Network]) -> Iterator[Network]:
    every = list(networks)
    for version in (4, 6):
        yield from ipaddress.collapse_addresses([n for n in every if n.version == version])  # type: ignore[type-var]
