"""JSON text that is made piece by piece, so that a thread which writes a long one does not stop the loop.

The encoder of the standard library holds the interpreter's lock until it has all of its text: a tenth of a
second for the ways of one scan of beams. Between two pieces here the lock can change hands.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

_AT_ONCE = 200  # items of a list, each a number or a few
_FEW = 16
_ENCODERS = {ascii: json.JSONEncoder(allow_nan=False, ensure_ascii=ascii) for ascii in (False, True)}


class JsonText(str):
    """The text of a value that was made before, in another process."""

    __slots__ = ()


def json_text(value: Any, *, ensure_ascii: bool = True) -> str:
    """The text of ``json.dumps(value, allow_nan=False, ensure_ascii=...)``, its errors as well."""
    return "".join(_pieces(value, ensure_ascii))


def _pieces(value: Any, ensure_ascii: bool) -> Iterator[str]:
    if isinstance(value, Mapping) and value:
        mark = "{"
        for key, item in value.items():
            yield mark + _text({key: None}, ensure_ascii)[1:-5]  # the key as an object has it, and its colon
            yield from _pieces(item, ensure_ascii)
            mark = ", "
        yield "}"
    elif isinstance(value, list | tuple) and value:
        mark = "["
        for start in range(0, len(value), _AT_ONCE):
            part = value[start : start + _AT_ONCE]
            if _is_short(part[0]):  # the others are taken to be like it: a long one costs time, and no more
                yield mark + _text(part, ensure_ascii)[1:-1]
                mark = ", "
                continue
            for item in part:
                yield mark
                yield from _pieces(item, ensure_ascii)
                mark = ", "
        yield "]"
    else:
        yield _text(value, ensure_ascii)


def _is_short(item: Any) -> bool:
    if isinstance(item, list | tuple):
        return len(item) <= _FEW and not any(isinstance(part, list | tuple | Mapping) for part in item)
    return not isinstance(item, Mapping)


def _text(value: Any, ensure_ascii: bool) -> str:
    return _ENCODERS[ensure_ascii].encode(value)
