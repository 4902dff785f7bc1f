"""Processes of the twin: they never outlive their parent, and the controller comes first."""

import contextlib
import ctypes
import os
import signal

_PR_SET_PDEATHSIG = 1


CONTROLLER_NICE, CAMERA_NICE = -12, -10


def set_priority(nice: int) -> None:
    """Run before or after others when the system permits: a real controller has a computer of its own."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, nice)


def die_with_parent(how: signal.Signals = signal.SIGKILL) -> None:
    """Ask the kernel to send ``how`` to this process when the thread that started it ends (Linux)."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, how, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() == 1:  # the parent ended before the request
        os.kill(os.getpid(), how)
