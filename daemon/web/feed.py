"""The state as it goes to every page: made once for all who watch, after changes, at a bounded rate."""

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

PERIOD_S = 0.2  # states come at most this often ...
IDLE_S = 1.0  # ... and at least this often, so that a page can tell quiet from dead


class States(Protocol):
    """Makes the state of now, and tells when there is another one."""

    def make(self) -> dict[str, Any]: ...
    def subscribe(self, listener: Callable[[], None], /) -> Callable[[], None]: ...
    def close(self) -> None: ...


class Feed:
    """Numbered states as bytes of server-sent events; nothing is made while nobody watches."""

    def __init__(self, states: States) -> None:
        self._states = states
        self._changed, self._watched = asyncio.Event(), asyncio.Event()
        self._news = asyncio.Event()
        self._event = b""
        self.number = 0
        self.watching = 0
        self.closed = False

    async def run(self) -> None:
        """Make states for ever; at the end those who watch are let go."""
        unsubscribe = self._states.subscribe(self._changed.set)
        try:
            while True:
                await self._watched.wait()
                self._changed.clear()
                self._publish()
                await asyncio.sleep(PERIOD_S)
                with suppress(TimeoutError):
                    async with asyncio.timeout(IDLE_S - PERIOD_S):
                        await self._changed.wait()
        finally:
            unsubscribe()
            self.closed = True
            self._tell()

    def _publish(self) -> None:
        self.number += 1
        text = json.dumps(self._states.make(), default=str, separators=(",", ":"))
        self._event = f"event: state\nid: {self.number}\ndata: {text}\n\n".encode()
        self._tell()

    def _tell(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    async def after(self, number: int) -> tuple[int, bytes]:
        """The newest state once there is one that is newer than ``number``; a slow reader misses some."""
        while self.number <= number and not self.closed:
            await self._news.wait()
        return self.number, self._event

    def begin_watch(self) -> int:
        """Count one who watches; returns after which state. It gets one that is made for it, soon."""
        self.watching += 1
        self._watched.set()
        self._changed.set()
        return self.number

    def end_watch(self) -> None:
        self.watching -= 1
        if not self.watching:
            self._watched.clear()
