"""The files of a recording, as bytes; ``docs/recordings.md`` describes them for other programs.

A recording is a folder of segments ``wire-000001.bin``, ``wire-000002.bin``, ... Each begins with
:data:`MAGIC`; then records follow, each a header (little-endian: kind, channel, time, length) and ``length``
bytes. A segment can be read without those before it: its first record is HEADER, and the channels that were
open when it began are opened in it once more.
"""

import struct
from enum import IntEnum

MAGIC = b"CWWIRE1\n"
RECORD = struct.Struct("<BIdI")
VERSION = 1
LONGEST = 1 << 24
"""Bytes in one record, at most."""


class Kind(IntEnum):
    """What a record says; HEADER, OPENED and LEFT_OUT hold a JSON object, SENT and RECEIVED raw bytes."""

    HEADER = 0
    OPENED = 1
    RECEIVED = 2
    SENT = 3
    CLOSED = 4
    LEFT_OUT = 5


def segment_name(number: int) -> str:
    """Of the file; numbers begin with 1."""
    return f"wire-{number:06d}.bin"
