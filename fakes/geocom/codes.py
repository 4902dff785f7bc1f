"""Return codes of the twin's station, and the shape of its procedures."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

Value = bool | int | float | str
Answer = tuple[int, tuple[Value, ...]]
Parameters = tuple[float, ...]

OK, IVPARAM, FATAL, NOT_IMPL, ABORT = 0, 2, 4, 5, 8
NO_FULL_CORRECTION, DOUBT, NO_DISTANCE, DISTANCE_ERROR = 1283, 1284, 1285, 1292
NO_TARGET, MULTIPLE_TARGETS, NOT_ENABLED, NO_LOCK = 8710, 8711, 8714, 8725
# These are the line's: they stand where a line that is well has 0.
WRONG_FORMAT, CANNOT_DECODE, OVERRUN, WRONG_CHECKSUM = 3078, 3080, 3100, 3101
OF_THE_LINE = range(3072, 3200)


@dataclass(frozen=True)
class RequestCode:
    """How many numbers it takes, and what it does with them."""

    takes: int
    act: Callable[[Parameters], Awaitable[Answer] | Answer]


def told(value: Callable[[], Value | tuple[Value, ...]]) -> RequestCode:
    """A procedure that tells something."""

    def tell(_: Parameters) -> Answer:
        found = value()
        return OK, found if isinstance(found, tuple) else (found,)

    return RequestCode(0, tell)
