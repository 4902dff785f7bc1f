"""Importing much at once without the collector of garbage."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_collector() -> Iterator[None]:
    """For imports alone: what lives at the end is taken to live as long as the process.

    Almost all that modules make does. To look through it again every 700 new objects takes a tenth of the
    time that a daemon, a twin or a solver needs to start.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if was_on:
            gc.enable()
