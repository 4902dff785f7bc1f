"""What a test may leave behind in this process: threads, sockets and children."""

import os
import threading
import time
from collections.abc import Callable, Collection

import psutil

PATIENCE_S = 2.0  # what has begun to end gets that long


def require_gone(what: str, before: set[str], now: Callable[[], set[str]]) -> None:
    """Nothing that ``now`` finds was not there ``before``; what ends shortly is waited for."""
    deadline = time.monotonic() + PATIENCE_S
    while (left := now() - before) and time.monotonic() < deadline:
        threading.Event().wait(0.02)
    assert not left, f"{what} left behind: {left} of {psutil.Process().net_connections(kind='all')}"


def threads() -> set[str]:
    return {f"{t.name}#{t.ident}" for t in threading.enumerate()}


def children(not_of: Collection[int] = ()) -> set[str]:
    """Processes below this one; without what those of the numbers ``not_of`` start, as a daemon that serves
    several tests does."""
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:  # no child at all: most tests need not look through all processes
        return set()
    found = set()
    for child in psutil.Process().children(recursive=True):
        try:
            if child.status() == psutil.STATUS_ZOMBIE or _is_lasting(child):
                continue
            if not not_of or not any(above.pid in not_of for above in child.parents()):
                found.add(f"{child.pid} {' '.join(child.cmdline())[:80]}")
        except psutil.NoSuchProcess:
            continue
    return found


def _is_lasting(child: psutil.Process) -> bool:
    """multiprocessing keeps two processes for the life of the interpreter: one tracks, one is copied. Its
    copies have the same command line."""
    words = " ".join(child.cmdline())
    return "resource_tracker" in words or ("forkserver" in words and child.ppid() == os.getpid())


def sockets() -> set[str]:
    """By descriptor and inode: what they are connected to takes a hundred times as long to find out."""
    found = set()
    for fd in os.listdir("/proc/self/fd"):
        try:
            target = os.readlink(f"/proc/self/fd/{fd}")
        except OSError:  # the one of this list
            continue
        if target.startswith("socket:"):
            found.add(f"fd {fd} {target}")
    return found
