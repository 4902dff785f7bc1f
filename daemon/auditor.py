"""Audit lines on their way to the disk: in order, away from the loop, and never without bound."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable

log = logging.getLogger("cellward.audit")

Audit = Callable[[str, str, bool, str], None]
MAX_WAITING = 1000
DRAIN_S = 2.0


class Auditor:
    """Hands lines (who, what, accepted, detail) to a function that blocks on the disk."""

    def __init__(self, audit: Audit | None) -> None:
        self._audit = audit
        self._lines: deque[tuple[str, str, bool, str]] = deque()
        self._unlisted = 0
        self._wake = asyncio.Event()
        self._closing = False
        self._task: asyncio.Task[None] | None = None

    def note(self, who: str, what: str, accepted: bool, detail: str = "") -> None:
        """One line; beyond what can wait, lines are only counted."""
        if self._audit is None:
            return
        if len(self._lines) >= MAX_WAITING:
            self._unlisted += 1
            return
        self._lines.append((who, what, accepted, detail))
        self._wake.set()

    def start(self) -> None:
        self._task = asyncio.create_task(self._run(), name="audit")

    async def stop(self) -> None:
        """Write what waits, for a short time, then end."""
        task, self._task = self._task, None
        if task is None:
            return
        self._closing = True
        self._wake.set()
        done, _ = await asyncio.wait([task], timeout=DRAIN_S)
        if not done:
            log.error("%d audit lines could not be written in time", len(self._lines))
            task.cancel()
            await asyncio.wait([task])

    async def _run(self) -> None:
        while not self._closing:
            await self._wake.wait()
            self._wake.clear()
            await self._drain()

    async def _drain(self) -> None:
        while self._lines or self._unlisted:
            if not self._lines:
                self._lines.append(("many", f"{self._unlisted} further writes", False, "too many to list"))
                self._unlisted = 0
            await self._write(self._lines.popleft())

    async def _write(self, line: tuple[str, str, bool, str]) -> None:
        assert self._audit is not None
        try:
            await asyncio.to_thread(self._audit, *line)
        except Exception:
            log.exception("an audit line could not be written: %s", line)
