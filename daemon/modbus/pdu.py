"""Modbus requests and replies as bytes: which function, which registers, which exception. No sockets."""

import struct
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Protocol

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, SERVER_FAILURE = 1, 2, 3, 4
IDENTIFICATION = ("Cellward", "cellward", version("cellward"))
MAX_BITS, MAX_READ, MAX_WRITE, MAX_READ_WRITE = 2000, 125, 123, 121


class ModbusError(Exception):
    """A request that is answered with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


class Bank(Protocol):
    """The registers behind a server; each method raises :class:`ModbusError`."""

    def read_discrete(self, address: int, count: int) -> Sequence[bool]: ...
    def read_input(self, address: int, count: int) -> Sequence[int]: ...
    def read_holding(self, address: int, count: int) -> Sequence[int]: ...
    def write_holding(self, address: int, values: Sequence[int], client: str) -> None:
        """All of ``values`` or none of them."""
        ...

    def write_coils(self, address: int, client: str) -> None:
        """Refuses: there are no coils."""
        ...


def respond(bank: Bank, request: bytes, client: str) -> bytes:
    """The reply to one request (function code and data, without unit id), an exception reply included."""
    function = request[0]
    try:
        handler = _FUNCTIONS.get(function)
        if handler is None:
            raise ModbusError(ILLEGAL_FUNCTION)
        return bytes([function]) + handler(bank, request[1:], client)
    except ModbusError as refusal:
        return bytes([function | 0x80, refusal.code])


def _read_discrete(bank: Bank, data: bytes, client: str) -> bytes:
    address, count = _span(data, MAX_BITS)
    bits = bank.read_discrete(address, count)
    packed = bytearray((count + 7) // 8)
    for index, bit in enumerate(bits):
        packed[index // 8] |= bool(bit) << index % 8
    return bytes([len(packed)]) + bytes(packed)


def _read_holding(bank: Bank, data: bytes, client: str) -> bytes:
    return _words(bank.read_holding(*_span(data, MAX_READ)))


def _read_input(bank: Bank, data: bytes, client: str) -> bytes:
    return _words(bank.read_input(*_span(data, MAX_READ)))


def _write_coils(bank: Bank, data: bytes, client: str) -> bytes:
    bank.write_coils(_unpack(">H", data[:2])[0], client)
    raise ModbusError(ILLEGAL_ADDRESS)


def _read_coils(bank: Bank, data: bytes, client: str) -> bytes:
    raise ModbusError(ILLEGAL_ADDRESS)


def _write_register(bank: Bank, data: bytes, client: str) -> bytes:
    address, value = _unpack(">HH", data)
    bank.write_holding(address, [value], client)
    return data


def _write_registers(bank: Bank, data: bytes, client: str) -> bytes:
    address, count, size = _unpack(">HHB", data[:5])
    bank.write_holding(address, _values(data[5:], count, size, MAX_WRITE), client)
    return data[:4]


def _mask_write(bank: Bank, data: bytes, client: str) -> bytes:
    address, keep, add = _unpack(">HHH", data)
    value = bank.read_holding(address, 1)[0]
    bank.write_holding(address, [(value & keep) | (add & ~keep & 0xFFFF)], client)
    return data


def _read_write(bank: Bank, data: bytes, client: str) -> bytes:
    """The write comes first; a read that is not possible must not leave it done."""
    read_at, read_count, address, count, size = _unpack(">HHHHB", data[:9])
    if not 1 <= read_count <= MAX_READ:
        raise ModbusError(ILLEGAL_VALUE)
    values = _values(data[9:], count, size, MAX_READ_WRITE)
    bank.read_holding(read_at, read_count)
    bank.write_holding(address, values, client)
    return _words(bank.read_holding(read_at, read_count))


def _identify(bank: Bank, data: bytes, client: str) -> bytes:
    """Read Device Identification: the basic objects (vendor, product, revision), as a stream or one."""
    kind, code, wanted = _unpack(">BBB", data)
    if kind != 14:
        raise ModbusError(ILLEGAL_FUNCTION)
    if not 1 <= code <= 4:
        raise ModbusError(ILLEGAL_VALUE)
    if code == 4:
        if wanted >= len(IDENTIFICATION):
            raise ModbusError(ILLEGAL_ADDRESS)
        numbers = [wanted]
    else:  # one that is not there begins the stream anew
        numbers = list(range(wanted if wanted < len(IDENTIFICATION) else 0, len(IDENTIFICATION)))
    objects = b"".join(
        bytes([n, len(IDENTIFICATION[n])]) + IDENTIFICATION[n].encode("ascii") for n in numbers
    )
    return bytes([14, code, 0x81, 0, 0, len(numbers)]) + objects


_FUNCTIONS: dict[int, Callable[[Bank, bytes, str], bytes]] = {
    43: _identify,
    1: _read_coils,
    2: _read_discrete,
    3: _read_holding,
    4: _read_input,
    5: _write_coils,
    6: _write_register,
    15: _write_coils,
    16: _write_registers,
    22: _mask_write,
    23: _read_write,
}


def _span(data: bytes, most: int) -> tuple[int, int]:
    address, count = _unpack(">HH", data)
    if not 1 <= count <= most:
        raise ModbusError(ILLEGAL_VALUE)
    return address, count


def _values(data: bytes, count: int, size: int, most: int) -> list[int]:
    if not 1 <= count <= most or size != 2 * count or len(data) != size:
        raise ModbusError(ILLEGAL_VALUE)
    return list(struct.unpack(f">{count}H", data))


def _words(values: Sequence[int]) -> bytes:
    return struct.pack(f">B{len(values)}H", 2 * len(values), *values)


def _unpack(shape: str, data: bytes) -> tuple[int, ...]:
    if len(data) != struct.calcsize(shape):
        raise ModbusError(ILLEGAL_VALUE)
    return struct.unpack(shape, data)
