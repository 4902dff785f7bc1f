"""Width and height of an image from its header alone: PNG, JPEG, BMP, TIFF and PNM."""

import re
import struct

_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_PNM = re.compile(rb"P[1-6](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257


def image_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in pixels; None when the header is cut or of another kind."""
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return _positive(*struct.unpack_from(">II", data, 16))
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith(b"BM"):
            return _bmp(data)
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff(data, "<" if data[:2] == b"II" else ">")
    except struct.error:
        return None
    found = _PNM.match(data[:1000])
    return None if found is None else _positive(int(found[1]), int(found[2]))


def _positive(width: int, height: int) -> tuple[int, int] | None:
    return (width, height) if width > 0 and height > 0 else None


def _jpeg(data: bytes) -> tuple[int, int] | None:
    at = 2
    while True:
        mark, kind, length = struct.unpack_from(">BBH", data, at)
        if mark != 0xFF or length < 2:
            return None
        if kind == 0xFF:  # a filling byte
            at += 1
        elif kind in _START_OF_FRAME:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return _positive(width, height)
        else:
            at += 2 + length


def _bmp(data: bytes) -> tuple[int, int] | None:
    (header,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if header == 12 else "<ii", data, 18)
    return _positive(width, abs(height))  # from the top where negative


def _tiff(data: bytes, order: str) -> tuple[int, int] | None:
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    sides = {}
    for k in range(count):
        tag, kind, _, value = struct.unpack_from(f"{order}HHII", data, at + 2 + 12 * k)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            if kind == 3:  # 16 bits stand at the front of the field
                (value,) = struct.unpack_from(f"{order}H", data, at + 10 + 12 * k)
            sides[tag] = value
    if len(sides) != 2:
        return None
    return _positive(sides[_TIFF_WIDTH], sides[_TIFF_HEIGHT])
