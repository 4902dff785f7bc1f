"""Real time for what must not wait, where the system permits it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

LOOP, SETPOINTS = 1, 2  # SCHED_RR priorities; a controller's own computer is not here


@contextmanager
def real_time(priority: int) -> Iterator[None]:
    """Run this thread before all ordinary ones meanwhile; without the right to, it runs as it is.

    Niceness does not do it: it shares a core, and a loop that gets its share late is late all the same.
    """
    before, param = os.sched_getscheduler(0), os.sched_getparam(0)
    granted = True
    try:
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError:
        granted = False
    try:
        yield
    finally:
        if granted:
            # The flag stays: only CAP_SYS_NICE may clear it, and a daemon under its unit has no capability.
            with suppress(OSError):
                os.sched_setscheduler(0, before | os.SCHED_RESET_ON_FORK, param)
