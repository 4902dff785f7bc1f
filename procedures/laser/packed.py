"""Passes of a scan as short texts, one each, for what is kept in memory and stored again and again.

A reference keeps the passes that it was made from, as each later measurement is solved together with them:
a hundred thousand numbers, which cost a tenth of a second whenever JSON or a pickle of them is read. The data
set beside the result has them plain.
"""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

from cell.errors import error
from cell.store.files import to_json

MOST_BYTES = 64 * 2**20  # of one pass: a thousand times what the slowest way has


def packed(entry: Mapping[str, Any]) -> str:
    """The JSON of a pass, compressed by zlib, in base64."""
    return base64.b64encode(zlib.compress(to_json(entry).encode())).decode("ascii")


def unpacked(entry: str | Mapping[str, Any]) -> dict[str, Any]:
    """The pass again; references of earlier versions have it plain. ``RESULT_INVALID`` for another text."""
    found = entry
    if isinstance(entry, str):
        try:
            inflate = zlib.decompressobj()
            text = inflate.decompress(base64.b64decode(entry, validate=True), MOST_BYTES)
            if not inflate.eof:
                raise ValueError(f"it is cut off, or longer than {MOST_BYTES} bytes")
            found = json.loads(text, parse_constant=_refuse_constant)
        except (ValueError, RecursionError, zlib.error) as exc:
            raise error("RESULT_INVALID", f"a pass of a laser reference cannot be unpacked: {exc}") from exc
    if not isinstance(found, Mapping):
        raise error("RESULT_INVALID", "a pass of a laser reference is no object")
    return dict(found)


def same_passes(one: Sequence[Any], other: Sequence[Any]) -> bool:
    """Whether both hold the same; the texts may differ where they were compressed by different programs."""
    return len(one) == len(other) and all(
        a == b or unpacked(a) == unpacked(b) for a, b in zip(one, other, strict=True)
    )


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")
