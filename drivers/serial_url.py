"""The part of a url that describes a serial line: ``scheme:///dev/NAME?baudrate=115200&parity=N&stopbits=1``."""

from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit


@dataclass(frozen=True)
class SerialLine:
    """Eight data bits, always; ``parity`` is N, E or O."""

    path: str
    baudrate: int = 115200
    parity: str = "N"
    stopbits: int = 1


def parse_serial(url: str) -> SerialLine:
    """``ValueError`` with a sentence for anything that is not a serial line."""
    parts = urlsplit(url)
    query = dict(parse_qsl(parts.query, keep_blank_values=True))
    if parts.netloc or not parts.path.startswith("/"):
        raise ValueError(f"url '{url}' should be {parts.scheme}:///dev/NAME, with three slashes")
    if unknown := sorted(set(query) - {"baudrate", "parity", "stopbits"}):
        raise ValueError(
            f"url '{url}' has the unknown setting '{unknown[0]}'; there is baudrate, parity, stopbits"
        )
    baudrate = query.get("baudrate", "115200")
    parity = query.get("parity", "N")
    stopbits = query.get("stopbits", "1")
    if not (baudrate.isascii() and baudrate.isdecimal() and 300 <= int(baudrate) <= 4_000_000):
        raise ValueError(f"url '{url}': baudrate '{baudrate}' is no number from 300 to 4000000")
    if parity not in ("N", "E", "O"):
        raise ValueError(f"url '{url}': parity '{parity}' should be N, E or O")
    if stopbits not in ("1", "2"):
        raise ValueError(f"url '{url}': stopbits '{stopbits}' should be 1 or 2")
    return SerialLine(parts.path, int(baudrate), parity, int(stopbits))
