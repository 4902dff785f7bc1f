"""Whether this process itself was late, so that a reading which is too old is not blamed on a link.

The health monitor notes here how late the event loop was; an error about something that came too late asks
:func:`busy_words`. One record a process: there is one loop, and it is late for everybody in it.
"""

from collections import deque

TOLD_S = 0.03  # a shorter delay explains nothing
RECENT_S = 2.0

_late: deque[tuple[float, float]] = deque(maxlen=200)
_due: list[float] = []  # when the monitor wants to be woken next; empty while nothing is watched


def expect(due: float) -> None:
    """The loop's monitor wants to be woken at ``due`` (s, monotonic)."""
    _due[:] = [due]


def woken(now: float) -> None:
    """The monitor was woken, late or in time."""
    if _due and (late := now - _due[0]) > TOLD_S:
        _late.append((now, late))


def forget() -> None:
    """Nothing is watched any more."""
    _due.clear()
    _late.clear()


def longest(now: float) -> float:
    """The longest delay of the last two seconds, the one that goes on included; 0.0 while none was long."""
    recent = [late for at, late in _late if now - at <= RECENT_S]
    running = now - _due[0] if _due else 0.0
    return max([*recent, running if running > TOLD_S else 0.0], default=0.0)


def busy_words(now: float) -> str:
    """What to add to an error about something too late, empty while this process was in time."""
    late = longest(now)
    return "" if late == 0.0 else f"; this machine was busy: loop lag {1e3 * late:.0f} ms"
