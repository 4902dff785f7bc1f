"""Processes of the twin: they never outlive their parent, and leave the cores to those who are measured."""

import contextlib
import ctypes
import gc
import multiprocessing
import os
import signal

from cell.priority import SIMULATED_CONTROLLER, yield_to_others

_PR_SET_PDEATHSIG = 1
_COLLECT_AFTER = 20_000, 20, 100  # new objects; passes over the young; passes over the middle-aged


def run_as_controller() -> None:
    """Run this thread before ordinary ones where the system permits: a real controller has its own computer.

    It comes after all real time of the daemon, which would not have to share a core with it either. Children
    are ordinary again.
    """
    with contextlib.suppress(PermissionError):
        policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(SIMULATED_CONTROLLER))


def run_as_camera() -> None:
    """Draw behind the controller and the daemon's loop, and beside what looks at the pictures."""
    yield_to_others()


def settle_collector() -> None:
    """Call it when what stays has been made: later passes of the collector do not look at it.

    They come rarely, too, so who serves a stream should ask for one while nobody waits.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_COLLECT_AFTER)


def die_with_parent(how: signal.Signals = signal.SIGKILL) -> None:
    """Ask the kernel to send ``how`` to this process when the thread that started it ends (Linux)."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, how, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    parent = multiprocessing.parent_process()
    starts_all = parent is not None and parent.pid == 1  # in a container the twin itself may be process 1
    if os.getppid() == 1 and not starts_all:  # the parent ended before the request
        os.kill(os.getpid(), how)
