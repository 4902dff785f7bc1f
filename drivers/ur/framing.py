"""Messages between the daemon and the motion child: ``uint32`` big-endian length, then JSON."""

import json
import struct
from typing import Any

_LENGTH = struct.Struct(">I")
MAX_BYTES = 1 << 20

Message = dict[str, Any]


def encode(message: Message) -> bytes:
    """One framed message. ValueError for numbers that are not finite."""
    body = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
    return _LENGTH.pack(len(body)) + body


class Unframer:
    """Cuts a byte stream into messages."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Message]:
        """The messages completed by ``data``; ValueError when the stream cannot be one of ours."""
        self._rest += data
        messages: list[Message] = []
        while len(self._rest) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._rest)
            if length > MAX_BYTES:
                raise ValueError(f"message of {length} bytes")
            end = _LENGTH.size + length
            if len(self._rest) < end:
                break
            message = json.loads(bytes(self._rest[_LENGTH.size : end]))
            if not isinstance(message, dict):
                raise ValueError("a message is a JSON object")
            messages.append(message)
            del self._rest[:end]
        return messages
