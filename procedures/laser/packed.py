"""Passes of a scan as short texts, one each, for what is kept in memory and stored again and again.

A reference keeps the passes that it was made from, as each later measurement is solved together with them:
a hundred thousand numbers, which cost a tenth of a second whenever JSON or a pickle of them is read. The data
set beside the result has them plain.
"""

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

from cell.errors import error
from cell.store.files import to_json


def packed(entry: Mapping[str, Any]) -> str:
    """The JSON of a pass, compressed by zlib, in base64."""
    return base64.b64encode(zlib.compress(to_json(entry).encode())).decode("ascii")


def unpacked(entry: str | Mapping[str, Any]) -> dict[str, Any]:
    """The pass again; references of earlier versions have it plain. ``RESULT_INVALID`` for another text."""
    if not isinstance(entry, str):
        return dict(entry)
    try:
        found = json.loads(zlib.decompress(base64.b64decode(entry, validate=True)))
    except (ValueError, zlib.error) as exc:
        raise error("RESULT_INVALID", f"a pass of a laser reference cannot be unpacked: {exc}") from exc
    if not isinstance(found, dict):
        raise error("RESULT_INVALID", "a pass of a laser reference is no object")
    return found
