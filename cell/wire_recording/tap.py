"""What a driver tells a recording, if there is one: one line where bytes come in, one where they go out.

Which recording is on is a context variable: whoever starts the devices turns it on for them, and drivers of
other packages need no further argument. Without a recording a tap does nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class Tap(Protocol):
    """One connection. ``t`` is when the bytes were there, monotonic s; None: now."""

    def received(self, data: bytes, t: float | None = None) -> None: ...
    def sent(self, data: bytes, t: float | None = None) -> None: ...
    def closed(self) -> None: ...


class Recorder(Protocol):
    """Makes the tap of a connection; ``protocol`` is one of ``docs/recordings.md``, ``peer`` its address."""

    def channel(self, protocol: str, peer: str) -> Tap: ...


class _NoTap:
    """Nothing is recorded."""

    def received(self, data: bytes, t: float | None = None) -> None: ...
    def sent(self, data: bytes, t: float | None = None) -> None: ...
    def closed(self) -> None: ...


NO_TAP: Tap = _NoTap()

_recorder: ContextVar[Recorder | None] = ContextVar("wire recorder", default=None)


def tap(protocol: str, peer: str) -> Tap:
    """For a connection that has just been made."""
    recorder = _recorder.get()
    return NO_TAP if recorder is None else recorder.channel(protocol, peer)


@contextmanager
def recorded_by(recorder: Recorder) -> Iterator[None]:
    """Connections that are made inside, also by tasks that are started inside, are recorded."""
    token = _recorder.set(recorder)
    try:
        yield
    finally:
        _recorder.reset(token)
