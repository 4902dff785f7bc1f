"""The values of URScript programs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fakes.ur.runtime import ScriptError

LARGEST = 1000  # items of a list with the lists in it, or letters of a string


@dataclass(frozen=True)
class Pose:
    """``p[x, y, z, rx, ry, rz]``; told from a list of joints by its type."""

    values: tuple[float, ...]


Value = float | bool | str | Pose | list["Value"] | None


def is_number(value: Value) -> bool:
    """Whether it is a number; booleans are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def truth(value: Value) -> bool:
    """A condition's value; URScript has no others than True and False."""
    if not isinstance(value, bool):
        raise ScriptError(f"a condition must be True or False, not {value!r}")
    return value


def copied(value: Value) -> Value:
    """As an assignment keeps it: lists are copied. A value that is too large is a script error."""
    if _size(value) > LARGEST:
        raise ScriptError(f"a value with more than {LARGEST} items or letters")
    return _copy(value)


def _size(value: Value) -> int:
    if isinstance(value, list):
        return sum(map(_size, value), start=1)
    return len(value) if isinstance(value, str) else 1


def _copy(value: Value) -> Value:
    return [_copy(item) for item in value] if isinstance(value, list) else value


def number(value: Value, what: str) -> float:
    """A finite number, or a script error that names ``what``."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ScriptError(f"{what} must be a number")
    return value


def six(value: Value, what: str) -> Sequence[float]:
    """The six numbers of a pose or of a list."""
    items = value.values if isinstance(value, Pose) else value
    if not isinstance(items, list | tuple) or len(items) != 6:
        raise ScriptError(f"{what}: needs a pose or six joint angles")
    return [number(item, what) for item in items]


def shown(value: Value) -> str:
    """As textmsg() writes it."""
    if isinstance(value, Pose):
        return "p" + shown(list(value.values))
    if isinstance(value, list):
        return "[" + ", ".join(map(shown, value)) + "]"
    return f"{value:g}" if is_number(value) else str(value)
