"""GeoCOM's ASCII: ``%R1Q,rpc,id[,crc]:p1,p2`` asks, ``%R1P,com,id[,crc]:rc,v1,v2`` answers.

A check sum is CRC-16 (start 0) of the line without the field that holds it; who sends one gets one. A line
ends with CR. LF clears the receiver, so the LF after a CR does no harm, and one ahead of a request helps.
"""

import re
from dataclasses import dataclass

from fakes.geocom.codes import OVERRUN, WRONG_CHECKSUM, WRONG_FORMAT, Value
from fakes.wire.crc import crc16

ABORT_LINE = b"c"
LONGEST_LINE = 1024

_REQUEST = re.compile(r"%R1Q,(\d{1,6})(?:,(\d{1,6}))?(?:,(\d{1,5}))?:(.*)", re.ASCII)


@dataclass(frozen=True)
class Request:
    """One line that was understood; parameters are as sent."""

    rpc: int
    transaction: int
    checked: bool
    parameters: tuple[str, ...]


class RefusedLine(ValueError):
    """A line that is no request: the return code of the line, and the transaction when that could be read."""

    def __init__(self, code: int, transaction: int = 0) -> None:
        super().__init__(f"return code {code}")
        self.code, self.transaction = code, transaction


class Receiver:
    """Cuts bytes into lines, however they arrive."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Lines that are whole now; one that is longer than any request is cut."""
        lines = []
        for byte in data:
            if byte == 0x0A:
                self._buffer.clear()
            elif byte == 0x0D:
                if self._buffer:
                    lines.append(bytes(self._buffer))
                self._buffer.clear()
            elif len(self._buffer) <= LONGEST_LINE:
                self._buffer.append(byte)
        return lines


def parse(line: bytes) -> Request:
    """The request in ``line``; :class:`RefusedLine` for anything else."""
    if len(line) > LONGEST_LINE:
        raise RefusedLine(OVERRUN)
    match = _REQUEST.fullmatch(line.decode("ascii", "replace"))
    if match is None:
        raise RefusedLine(WRONG_FORMAT)
    rpc, transaction, crc, tail = match.groups()
    number = int(transaction or 0)
    if crc is not None:
        bare = line[: match.start(3) - 1] + line[match.end(3) :]
        if crc16(bare, 0) != int(crc):
            raise RefusedLine(WRONG_CHECKSUM, number)
    parameters = tuple(part.strip() for part in tail.split(",")) if tail.strip() else ()
    return Request(int(rpc), number, crc is not None, parameters)


def reply(
    transaction: int, code: int, values: tuple[Value, ...], digits: int, checked: bool, com: int = 0
) -> bytes:
    """A whole answer, CR LF included."""
    tail = ":" + ",".join([str(code), *(_written(value, digits) for value in values)])
    head = f"%R1P,{com},{transaction}"
    if checked:
        head += f",{crc16((head + tail).encode('ascii'), 0)}"
    return f"{head}{tail}\r\n".encode("ascii")


def _written(value: Value, digits: int) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, float):
        return f"{value:.{digits}f}"
    return str(int(value))
