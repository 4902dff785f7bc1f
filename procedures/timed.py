"""How long a solver takes. Who compares it with others takes the shortest time of a few calls, as the first
one pays for cold caches."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
LONG_S = 0.3  # what cold caches cost is little beside a call that takes so long


def timed(call: Callable[[], T], calls: int = 1) -> tuple[T, float]:
    """The last answer of ``calls`` calls and the shortest of their times, s; a long one is called once."""
    seconds = []
    for _ in range(calls):
        began = time.perf_counter()
        found = call()
        seconds.append(time.perf_counter() - began)
        if seconds[0] > LONG_S:
            break
    return found, min(seconds)
