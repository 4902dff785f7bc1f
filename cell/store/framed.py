"""Append-only binary streams: every frame carries its length and a check sum, a torn end costs one frame.

File: the line ``cellward.framed/1``, then frames of uint32 length, uint32 CRC-32 over length and payload
(little-endian), payload. The length is under the check sum, so a tail of zeros is not a row of empty frames.
"""

import struct
import zlib
from pathlib import Path
from types import TracebackType
from typing import Self

from cell.errors import error
from cell.store.files import AppendFile, contents

HEADER = b"cellward.framed/1\n"
MAX_FRAME_BYTES = 64 * 2**20
_PREFIX = struct.Struct("<II")


class FramedWriter:
    """Collects frames; ``flush`` hands them to the operating system, ``sync`` to the disk.

    An existing file is continued after its last whole frame; another kind of file is ``FILE_UNREADABLE``.
    """

    def __init__(self, path: Path) -> None:
        end = _scan(_read(path))[1] if path.exists() else 0
        self._file = AppendFile(path, keep=end)
        self._pending = bytearray()
        if end == 0:
            self._pending += HEADER

    def append(self, payload: bytes) -> None:
        """Add one frame; it is safe from a kill after the next :meth:`flush`."""
        if len(payload) > MAX_FRAME_BYTES:
            raise error("INTERNAL", f"a frame of {len(payload)} bytes, more than {MAX_FRAME_BYTES}")
        self._pending += _PREFIX.pack(len(payload), _check_sum(payload)) + payload

    def flush(self) -> None:
        """Hand over what was appended; after ``DISK_FULL`` it is kept for the next try."""
        if self._pending:
            self._file.append(bytes(self._pending))
            self._pending.clear()

    def sync(self) -> None:
        """Flush, and wait until the disk has it."""
        self.flush()
        self._file.sync()

    def close(self) -> None:
        try:
            self.flush()
        finally:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_framed(path: Path) -> tuple[list[bytes], bool]:
    """All whole frames of ``path`` in order, and whether the file ends where a frame ends.

    Reading stops at the first frame that is torn or does not match its check sum. ``FILE_MISSING``,
    ``FILE_UNREADABLE`` when it is not such a file at all.
    """
    data = _read(path)
    frames, end = _scan(data)
    return frames, end == len(data) and end > 0


def _read(path: Path) -> bytes:
    try:
        data = contents(path)
    except FileNotFoundError:
        raise error("FILE_MISSING", str(path)) from None
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc.strerror or exc}") from exc
    if not data.startswith(HEADER) and not HEADER.startswith(data):
        raise error("FILE_UNREADABLE", f"{path}: does not begin with '{HEADER.decode().strip()}'")
    return data


def _scan(data: bytes) -> tuple[list[bytes], int]:
    """The whole frames, and the offset where the last of them ends (0: not even the header)."""
    frames: list[bytes] = []
    if not data.startswith(HEADER):
        return frames, 0
    end = len(HEADER)
    while len(data) - end >= _PREFIX.size:
        length, check = _PREFIX.unpack_from(data, end)
        payload = data[end + _PREFIX.size : end + _PREFIX.size + length]
        if len(payload) != length or _check_sum(payload) != check:
            break
        frames.append(payload)
        end += _PREFIX.size + length
    return frames, end


def _check_sum(payload: bytes) -> int:
    return zlib.crc32(payload, zlib.crc32(struct.pack("<I", len(payload))))
