"""Processes of the twin: they never outlive their parent, and the controller comes first."""

import contextlib
import ctypes
import os
import signal

_PR_SET_PDEATHSIG = 1


_CAMERA_NICE = 0
_REAL_TIME_PRIORITY = 5


def run_as_controller() -> None:
    """Run this thread before all others where the system permits: a real controller has its own computer.

    Niceness alone does not do it: Linux shares the cores between sessions first.
    """
    with contextlib.suppress(PermissionError):
        policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_REAL_TIME_PRIORITY))


def run_as_camera() -> None:
    """Draw at plain priority: behind the daemon's loop, whose computer a real camera does not use."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _CAMERA_NICE)


def die_with_parent(how: signal.Signals = signal.SIGKILL) -> None:
    """Ask the kernel to send ``how`` to this process when the thread that started it ends (Linux)."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, how, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() == 1:  # the parent ended before the request
        os.kill(os.getpid(), how)
