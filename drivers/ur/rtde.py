"""Real-Time Data Exchange, version 2, as bytes: types, packages and the splitter of the byte stream.

Pure functions; nothing here knows about sockets. Layout after Universal Robots' RTDE guide: big-endian,
``uint16 size`` (the three header bytes included), ``uint8 type``, payload.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

from cell.errors import error

HEADER = struct.Struct(">HB")
VERSION = 2

Value = float | int | bool | tuple[float, ...] | tuple[int, ...]

_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}


class PackageType(IntEnum):
    """Package types; the values are the ASCII letters of the guide."""

    VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    MESSAGE = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


_KINDS = {int(kind): kind for kind in PackageType}


@dataclass(frozen=True)
class Package:
    """One package without its header."""

    kind: PackageType
    payload: bytes


@dataclass(frozen=True)
class Recipe:
    """The variables of one data package, in order, with the types the controller answered."""

    id: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @cached_property
    def layout(self) -> struct.Struct:
        """All values of a package, without the recipe id."""
        return struct.Struct(">" + "".join(_FORMATS[t] for t in self.types))

    def unpack(self, payload: bytes) -> dict[str, Value]:
        """The values by name; vectors as tuples. ``PROTOCOL_VIOLATION`` for another recipe or length."""
        if len(payload) != 1 + self.layout.size or payload[0] != self.id:
            raise error(
                "PROTOCOL_VIOLATION",
                f"data package of {len(payload)} bytes for recipe {payload[0] if payload else None}; "
                f"expected {1 + self.layout.size} bytes for recipe {self.id}",
            )
        flat = iter(self.layout.unpack_from(payload, 1))
        return {n: _take(flat, t) for n, t in zip(self.names, self.types, strict=True)}

    def pack(self, values: dict[str, Value]) -> bytes:
        """The payload of a data package; the inverse of :meth:`unpack`."""
        flat: list[float | int | bool] = []
        for name in self.names:
            value = values[name]
            flat.extend(value) if isinstance(value, tuple) else flat.append(value)
        return bytes([self.id]) + self.layout.pack(*flat)


def _take(flat: Iterator[float], type_: str) -> Value:
    count = int(_FORMATS[type_][:-1] or 1)
    return next(flat) if count == 1 else tuple(next(flat) for _ in range(count))


def encode(kind: PackageType, payload: bytes = b"") -> bytes:
    """A whole package."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def request_version(version: int = VERSION) -> bytes:
    """Ask for a protocol version; the reply is one byte, 1 when accepted."""
    return encode(PackageType.VERSION, struct.pack(">H", version))


def request_outputs(names: Sequence[str], frequency_hz: float) -> bytes:
    """Subscribe to ``names`` at ``frequency_hz``."""
    return encode(PackageType.OUTPUTS, struct.pack(">d", frequency_hz) + ",".join(names).encode("ascii"))


def request_inputs(names: Sequence[str]) -> bytes:
    """Claim input variables for writing."""
    return encode(PackageType.INPUTS, ",".join(names).encode("ascii"))


def parse_recipe(names: Sequence[str], payload: bytes) -> Recipe:
    """The reply to a setup request. Types are as answered: ``NOT_FOUND`` and ``IN_USE`` are possible."""
    types = tuple(payload[1:].decode("ascii", "replace").rstrip(",").split(","))
    if not payload or len(types) != len(names):
        raise error("PROTOCOL_VIOLATION", f"{len(names)} variables asked for, {len(types)} types answered")
    unknown = set(types) - set(_FORMATS) - {"NOT_FOUND", "IN_USE"}
    if unknown:
        raise error("PROTOCOL_VIOLATION", f"unknown RTDE types {sorted(unknown)}")
    return Recipe(payload[0], tuple(names), types)


def parse_flag(package: Package) -> bool:
    """The one-byte answer to a version, start or pause request."""
    if len(package.payload) != 1:
        raise error("PROTOCOL_VIOLATION", f"{package.kind.name} answered by {len(package.payload)} bytes")
    return package.payload[0] != 0


def parse_controller_version(payload: bytes) -> tuple[int, int, int, int]:
    """Major, minor, bugfix, build."""
    if len(payload) != 16:
        raise error("PROTOCOL_VIOLATION", f"controller version of {len(payload)} bytes")
    major, minor, bugfix, build = struct.unpack(">4I", payload)
    return major, minor, bugfix, build


class Splitter:
    """Cuts the byte stream into packages; keeps a half package until the rest comes."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Package]:
        """The packages completed by ``data``. ``PROTOCOL_VIOLATION`` as soon as a header cannot be one."""
        if self._rest:
            data = self._rest + data
        packages: list[Package] = []
        start, end = 0, len(data)
        while end - start >= HEADER.size:
            size, letter = HEADER.unpack_from(data, start)
            kind = _KINDS.get(letter)
            if kind is None or size < HEADER.size:
                raise error(
                    "PROTOCOL_VIOLATION",
                    f"RTDE header size {size}, type {letter:#04x} in the stream {data[start : start + 16]!r}",
                )
            if end - start < size:
                break
            packages.append(Package(kind, data[start + HEADER.size : start + size]))
            start += size
        self._rest = data[start:]
        return packages
