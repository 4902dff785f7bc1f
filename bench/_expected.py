"""What a bench must have before it can measure."""

from typing import TypeVar

T = TypeVar("T")


def expect(kind: type[T], value: object) -> T:
    """``value`` as a ``kind``; without it there is nothing to measure, and the bench ends."""
    if not isinstance(value, kind):
        raise SystemExit(f"nothing to measure: {value!r} in place of {kind.__name__}")
    return value
