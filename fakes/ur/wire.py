"""RTDE framing and data types, written from the public RTDE guide; big-endian throughout.

A package is ``uint16 size`` (which counts the three header bytes) and ``uint8 type``, then the payload.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

HEADER = struct.Struct(">HB")


class Package(IntEnum):
    """Package types; the numbers are ASCII letters."""

    SETUP_INPUTS = ord("I")
    TEXT_MESSAGE = ord("M")
    SETUP_OUTPUTS = ord("O")
    PAUSE = ord("P")
    START = ord("S")
    DATA = ord("U")
    PROTOCOL_VERSION = ord("V")
    CONTROL_VERSION = ord("v")


class Level(IntEnum):
    """Severity of a text message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


NOT_FOUND = "NOT_FOUND"
IN_USE = "IN_USE"

# Type name -> struct code of one value and number of values.
TYPES: dict[str, tuple[str, int]] = {
    "BOOL": ("?", 1),
    "UINT8": ("B", 1),
    "UINT32": ("I", 1),
    "UINT64": ("Q", 1),
    "INT32": ("i", 1),
    "DOUBLE": ("d", 1),
    "VECTOR3D": ("d", 3),
    "VECTOR6D": ("d", 6),
    "VECTOR6INT32": ("i", 6),
    "VECTOR6UINT32": ("I", 6),
}


class FramingError(ValueError):
    """The byte stream cannot be RTDE: a size below the header's own three bytes."""


class Framer:
    """Cuts a byte stream into packages; packages may arrive in pieces or several at once."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield ``(type, payload)`` for every package that ``data`` completes."""
        self._buffer += data
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size:
                raise FramingError(f"package size {size}")
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[HEADER.size : size])
            del self._buffer[:size]
            yield kind, payload


def package(kind: int, payload: bytes = b"") -> bytes:
    """One package with its header."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def text_message(text: str, level: Level, version: int, source: str = "RTDE") -> bytes:
    """A message from the controller; protocol 1 has only a level and the text."""
    body = text.encode()[:255]
    if version == 1:
        return package(Package.TEXT_MESSAGE, bytes([level]) + body)
    origin = source.encode()
    return package(
        Package.TEXT_MESSAGE, bytes([len(body)]) + body + bytes([len(origin)]) + origin + bytes([level])
    )


def split_names(payload: bytes) -> list[str]:
    """Variable names of a recipe; some clients end the list with a comma."""
    return [name for name in payload.decode("ascii", "replace").split(",") if name]


@dataclass(frozen=True)
class Layout:
    """How the values of a recipe lie in a data package."""

    types: tuple[str, ...]

    @property
    def struct(self) -> struct.Struct:
        codes = (f"{count}{code}" for code, count in (TYPES[t] for t in self.types))
        return struct.Struct(">" + "".join(codes))

    def unpack(self, payload: bytes) -> list[float | tuple[float, ...]]:
        """One value per variable, a tuple for vectors; ``ValueError`` when the length does not fit."""
        packed = self.struct
        if packed.size != len(payload):
            raise ValueError(f"{len(payload)} bytes where the recipe has {packed.size}")
        flat = packed.unpack(payload)
        values: list[float | tuple[float, ...]] = []
        start = 0
        for name in self.types:
            count = TYPES[name][1]
            values.append(flat[start] if count == 1 else flat[start : start + count])
            start += count
        return values
