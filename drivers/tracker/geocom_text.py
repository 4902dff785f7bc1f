"""GeoCOM's ASCII lines: ``%R1Q,rpc,id[,crc]:p1,p2`` and ``%R1P,com,id[,crc]:rc,v1,v2``.

The check sum is CRC-16/ARC over the line without the field that holds it.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal

Parameter = bool | int | float | str

_DECIMALS = 15
_REPLY = re.compile(r"%R1P,(\d{1,5}),(\d{1,5})(?:,(\d{1,5}))?:(\d{1,6})(?:,(.*))?", re.ASCII)
_ITEM = re.compile(r'"[^"]*"|[^,"]*')


class Unreadable(ValueError):
    """A line that is no reply."""


@dataclass(frozen=True)
class Reply:
    """``com`` is the line's own return code, ``rc`` that of the procedure; ``values`` are as sent."""

    com: int
    transaction: int
    rc: int
    values: tuple[str, ...] = ()

    @property
    def code(self) -> int:
        """The one return code that matters: a request that was not understood has no other."""
        return self.com or self.rc

    def floats(self, count: int) -> list[float]:
        """The first ``count`` values as finite numbers; :class:`Unreadable` when they are not there."""
        try:
            found = [float(v) for v in self.values[:count]]
        except ValueError as exc:
            raise Unreadable(f"a value of {self.values} is no number") from exc
        if len(found) < count or not all(map(math.isfinite, found)):
            raise Unreadable(f"{count} finite numbers were expected, not {self.values}")
        return found

    def text(self) -> str:
        """The first value without its quotes."""
        if not self.values:
            raise Unreadable("a text was expected, but there is no value")
        return self.values[0].strip().strip('"').strip()


def crc16(data: bytes) -> int:
    """CRC-16/ARC: polynomial 0x8005 reflected, start 0."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


def request(rpc: int, transaction: int, *parameters: Parameter, checksum: bool = False) -> bytes:
    """The line that asks for procedure ``rpc``, with its CR LF."""
    tail = ":" + ",".join(map(_written, parameters))
    head = f"%R1Q,{rpc},{transaction}"
    if checksum:
        head += f",{crc16((head + tail).encode('ascii'))}"
    return f"{head}{tail}\r\n".encode("ascii")


def parse_reply(line: bytes, *, checksum: bool = False) -> Reply:
    """The reply in ``line`` (without its CR LF); :class:`Unreadable` also when its check sum is wrong.

    ``checksum``: there must be one.
    """
    try:
        text = line.decode("ascii")
    except UnicodeDecodeError as exc:
        raise Unreadable("bytes that are no ASCII") from exc
    match = _REPLY.fullmatch(text)
    if match is None:
        raise Unreadable("no reply")
    com, transaction, crc, rc, values = match.groups()
    if crc is not None:
        bare = text[: match.start(3) - 1] + text[match.end(3) :]
        if crc16(bare.encode("ascii")) != int(crc):
            raise Unreadable("a wrong check sum")
    elif checksum:
        raise Unreadable("no check sum")
    found = () if values is None else tuple(_split(values))
    return Reply(int(com), int(transaction), int(rc), found)


def _written(value: Parameter) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        if not value.isascii() or not value.isprintable() or '"' in value:
            raise ValueError(f"{value!r} cannot be sent as a text")
        return f'"{value}"'
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be sent as a number")
    digits = format(Decimal(repr(round(value, _DECIMALS) + 0.0)), "f")  # no exponent, no minus zero
    return digits if "." in digits else digits + ".0"


def _split(values: str) -> Iterator[str]:
    """At commas, but not at those of a quoted text."""
    at = 0
    while True:
        item = _ITEM.match(values, at)
        begin, at = at, item.end() if item else at
        if at < len(values) and values[at] != ",":
            raise Unreadable("a quote that does not end")
        yield values[begin:at]
        if at >= len(values):
            return
        at += 1
