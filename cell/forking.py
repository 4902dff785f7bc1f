"""Whether a program may make a copy of itself, which has imported everything and so begins at once."""

import os


def may_fork() -> bool:
    """Whether this process has one thread; those of native libraries count as well.

    A copy has the locks of all threads as they were, and none of the others to give them back. What is open
    stays open in it, too: so a program makes its copies before its loop and its first socket.
    """
    return len(os.listdir("/proc/self/task")) == 1
