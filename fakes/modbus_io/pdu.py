"""Modbus requests and replies as bytes, from the public application protocol; no sockets, no framing.

A read is answered from one snapshot of the module; a write of several is done whole or not at all.
"""

import struct
from collections.abc import Callable, Mapping

from fakes.modbus_io.module import UnitTables

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4
MOST_BITS_READ, MOST_BITS_WRITTEN, MOST_WORDS_READ, MOST_WORDS_WRITTEN = 2000, 1968, 125, 123
READ_IDENTIFICATION = 14
CONFORMITY = 0x83  # extended objects, as a stream or one by one
_REGULAR_OBJECTS, _OBJECT_ROOM = 0x80, 244


class Refused(Exception):
    """A request that is answered with the exception ``code``."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


def respond(unit: UnitTables, request: bytes) -> bytes:
    """The reply to ``request`` (function code and data), an exception reply included."""
    function = request[0]
    try:
        handler = _FUNCTIONS.get(function)
        if handler is None:
            raise Refused(ILLEGAL_FUNCTION)
        return bytes([function]) + handler(unit, request[1:])
    except Refused as refusal:
        return exception(function, refusal.code)


def exception(function: int, code: int) -> bytes:
    """The reply that refuses ``function``."""
    return bytes([function | 0x80, code])


def _read_coils(unit: UnitTables, data: bytes) -> bytes:
    return _bits(unit.coils(), data)


def _read_discrete(unit: UnitTables, data: bytes) -> bytes:
    return _bits(unit.discrete(), data)


def _read_holding(unit: UnitTables, data: bytes) -> bytes:
    return _words(unit.holding(), data)


def _read_input(unit: UnitTables, data: bytes) -> bytes:
    return _words(unit.input(), data)


def _write_coil(unit: UnitTables, data: bytes) -> bytes:
    address, value = _unpack(">HH", data)
    if value not in (0x0000, 0xFF00):
        raise Refused(ILLEGAL_VALUE)
    unit.coil(address, value != 0)()
    return data


def _write_register(unit: UnitTables, data: bytes) -> bytes:
    address, value = _unpack(">HH", data)
    unit.register(address, value)()
    return data


def _write_coils(unit: UnitTables, data: bytes) -> bytes:
    address, count, size = _unpack(">HHB", data[:5])
    packed = data[5:]
    if not 1 <= count <= MOST_BITS_WRITTEN or size != (count + 7) // 8 or len(packed) != size:
        raise Refused(ILLEGAL_VALUE)
    bits = [bool(packed[i // 8] >> i % 8 & 1) for i in range(count)]
    _all([unit.coil(address + i, bit) for i, bit in enumerate(bits)])
    return data[:4]


def _write_registers(unit: UnitTables, data: bytes) -> bytes:
    address, count, size = _unpack(">HHB", data[:5])
    if not 1 <= count <= MOST_WORDS_WRITTEN or size != 2 * count or len(data) != 5 + size:
        raise Refused(ILLEGAL_VALUE)
    words = struct.unpack(f">{count}H", data[5:])
    _all([unit.register(address + i, word) for i, word in enumerate(words)])
    return data[:4]


def _read_and_write(unit: UnitTables, data: bytes) -> bytes:
    """Function 23: the write comes first."""
    _write_registers(unit, data[4:])
    return _read_holding(unit, data[:4])


def _identify(unit: UnitTables, data: bytes) -> bytes:
    """Device identification: basic, regular and extended streams, or a single object."""
    if data[:1] != bytes([READ_IDENTIFICATION]):
        raise Refused(ILLEGAL_FUNCTION)
    _, code, first = _unpack(">BBB", data)
    objects = {number: text.encode() for number, text in unit.identity.objects().items()}
    if code == 4:
        if first not in objects:
            raise Refused(ILLEGAL_ADDRESS)
        wanted = [first]
    elif code in (1, 2, 3):
        there = [number for number in objects if code == 3 or number < _REGULAR_OBJECTS]
        wanted = [number for number in there if number >= first] if first in there else there
    else:
        raise Refused(ILLEGAL_VALUE)
    body, told = b"", 0
    for number in wanted:
        entry = bytes([number, len(objects[number])]) + objects[number]
        if len(body) + len(entry) > _OBJECT_ROOM:
            break
        body, told = body + entry, told + 1
    more, following = (0xFF, wanted[told]) if told < len(wanted) else (0, 0)
    return bytes([READ_IDENTIFICATION, code, CONFORMITY, more, following, told]) + body


_FUNCTIONS: dict[int, Callable[[UnitTables, bytes], bytes]] = {
    1: _read_coils,
    2: _read_discrete,
    3: _read_holding,
    4: _read_input,
    5: _write_coil,
    6: _write_register,
    15: _write_coils,
    16: _write_registers,
    23: _read_and_write,
    43: _identify,
}


def _bits(table: Mapping[int, bool], data: bytes) -> bytes:
    addresses = _span(table, data, MOST_BITS_READ)
    packed = bytearray((len(addresses) + 7) // 8)
    for index, address in enumerate(addresses):
        packed[index // 8] |= table[address] << index % 8
    return bytes([len(packed)]) + bytes(packed)


def _words(table: Mapping[int, int], data: bytes) -> bytes:
    addresses = _span(table, data, MOST_WORDS_READ)
    words = [table[address] for address in addresses]
    return struct.pack(f">B{len(words)}H", 2 * len(words), *words)


def _span(table: Mapping[int, object], data: bytes, most: int) -> range:
    address, count = _unpack(">HH", data)
    if not 1 <= count <= most:
        raise Refused(ILLEGAL_VALUE)
    addresses = range(address, address + count)
    if not all(a in table for a in addresses):
        raise Refused(ILLEGAL_ADDRESS)
    return addresses


def _all(actions: list[Callable[[], None]]) -> None:
    for action in actions:
        action()


def _unpack(shape: str, data: bytes) -> tuple[int, ...]:
    if len(data) != struct.calcsize(shape):
        raise Refused(ILLEGAL_VALUE)
    return struct.unpack(shape, data)
