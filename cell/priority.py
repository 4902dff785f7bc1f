"""Who comes first on this machine's cores: real time for what must not wait, the rest behind it.

Niceness does not keep anything in time: it shares a core, and the kernel shares the cores between sessions
before it looks at it. Children inherit real time: those that compute or draw give it up when they begin.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# SCHED_RR priorities. The first is for the clock of a simulated controller: a real one has a computer of its
# own, so everything of the daemon that follows the arm comes before it.
SIMULATED_CONTROLLER, LOOP, SETPOINTS = 1, 2, 3
COMPUTING = 5  # niceness; what looks at pictures has none, or it would get no core beside busy programs


@contextmanager
def real_time(priority: int) -> Iterator[None]:
    """Run this thread before all ordinary ones meanwhile; without the right to, it runs as it is."""
    granted = _ask(0, priority)
    try:
        yield
    finally:
        if granted:
            _give_back(0)


@contextmanager
def process_in_real_time(priority: int) -> Iterator[None]:
    """As :func:`real_time` for all threads of this process.

    A thread that waits for a core while it holds the interpreter's lock would stop all others.
    """
    for task in _tasks():
        with suppress(OSError):  # a thread may end between the listing and the question
            if os.sched_getscheduler(task) != os.SCHED_RR:
                _ask(task, priority)
    try:
        yield
    finally:
        for task in _tasks():
            with suppress(OSError):
                if os.sched_getparam(task).sched_priority == priority:
                    _give_back(task)


def stay_in_real_time(priority: int) -> None:
    """From now on, for this thread and those that it starts; where the system permits it."""
    _ask(0, priority)


def yield_to_others(niceness: int = 0) -> None:
    """For a process that computes or draws: in batches, behind real time, whatever its parent runs as."""
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)


def weigh_session(niceness: int, process: int | str = "self") -> None:
    """Give the session of ``process`` the share that this niceness has, against other sessions (autogroup).

    See sched(7). In a control group with a weight of its own, as under the service unit, that weight counts
    and this one is idle. Where the system does not permit it the session stays as it is.
    """
    with suppress(OSError):
        Path(f"/proc/{process}/autogroup").write_text(str(niceness), "ascii")


def _ask(task: int, priority: int) -> bool:
    try:
        os.sched_setscheduler(task, os.SCHED_RR, os.sched_param(priority))
    except OSError:
        return False
    return True


def _give_back(task: int) -> None:
    """Nobody needs a right for that."""
    with suppress(OSError):
        os.sched_setscheduler(task, os.SCHED_OTHER, os.sched_param(0))


def _tasks() -> list[int]:
    return [int(task.name) for task in Path("/proc/self/task").iterdir()]
