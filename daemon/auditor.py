"""Audit lines on their way to the disk: in order, away from the loop, and never without bound.

Refused writes of one client are gathered while they wait: a client that may not write decides how many there
are. An accepted write keeps a line and a place of its own.
"""

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime

log = logging.getLogger("cellward.audit")

Audit = Callable[[str, str, bool, str], None]
Line = tuple[str, str, bool, str]  # who, what, accepted, detail
MAX_WAITING_ACCEPTED = 10000
MAX_WAITING_REFUSED = 100
MAX_CLIENTS = 100
MAX_CHARS = 500
GATHER_S = 5.0
OWN_LINES = 20  # refused writes of a client that are listed one by one in this time; the rest makes one line
DRAIN_S = 2.0
MANY = "many"


@dataclass
class _Gathered:
    """The refused writes of one client beyond those that are listed one by one."""

    who: str
    what: str
    detail: str
    began: float
    first: str = field(default_factory=lambda: _wall_text())
    last: str = ""
    count: int = 0

    def row(self) -> Line:
        detail = f"first {self.first} ({self.what}: {self.detail}), last {self.last}"
        return self.who, f"{self.count} refused writes", False, detail


class Auditor:
    """Hands lines (who, what, accepted, detail) to a function that blocks on the disk."""

    def __init__(self, audit: Audit | None) -> None:
        self._audit = audit
        self._lines: deque[Line] = deque()
        self._refused_waiting = 0
        self._listed: dict[str, tuple[float, int]] = {}
        self._gathered: dict[str, _Gathered] = {}
        self._unlisted = 0
        self._wake = asyncio.Event()
        self._closing = False
        self._task: asyncio.Task[None] | None = None

    def note(self, who: str, what: str, accepted: bool, detail: str = "") -> None:
        """One line; refused writes that are many are counted by client, with the first and the last time."""
        if self._audit is None:
            return
        line = (who, _bounded(what), accepted, _bounded(detail))
        if accepted:
            if len(self._lines) - self._refused_waiting >= MAX_WAITING_ACCEPTED:
                self._unlisted += 1
                return
            self._lines.append(line)
        elif self._refused_waiting < MAX_WAITING_REFUSED and self._may_list(who):
            self._refused_waiting += 1
            self._lines.append(line)
        else:
            self._gather(line)
        self._wake.set()

    def _may_list(self, who: str) -> bool:
        now = time.monotonic()
        if len(self._listed) >= MAX_CLIENTS and who not in self._listed:
            self._listed = {k: v for k, v in self._listed.items() if now - v[0] < GATHER_S}
            if len(self._listed) >= MAX_CLIENTS:
                return False
        began, count = self._listed.get(who, (now, 0))
        if now - began >= GATHER_S:
            began, count = now, 0
        self._listed[who] = began, count + 1
        return count < OWN_LINES

    def _gather(self, line: Line) -> None:
        who, what, _, detail = line
        if who not in self._gathered and len(self._gathered) >= MAX_CLIENTS:
            who = MANY
        if who not in self._gathered:
            self._gathered[who] = _Gathered(who, what, detail, time.monotonic())
        gathered = self._gathered[who]
        gathered.count += 1
        gathered.last = _wall_text()

    def start(self) -> None:
        if self._audit is not None:
            self._task = asyncio.create_task(self._run(self._audit), name="audit")

    async def stop(self) -> None:
        """Write what waits, for a short time, then end."""
        task, self._task = self._task, None
        if task is None:
            return
        self._closing = True
        self._wake.set()
        done, _ = await asyncio.wait([task], timeout=DRAIN_S)
        if not done:
            log.error("%d audit lines could not be written in time", len(self._lines) + len(self._gathered))
            task.cancel()
            await asyncio.wait([task])

    async def _run(self, audit: Audit) -> None:
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(GATHER_S / 4 if self._gathered else None):
                    await self._wake.wait()
            self._wake.clear()
            await self._drain(audit)
            if self._closing and not self._lines and not self._gathered:
                return

    async def _drain(self, audit: Audit) -> None:
        while True:
            due = time.monotonic() - GATHER_S
            ripe = [w for w, g in self._gathered.items() if self._closing or g.began <= due]
            if self._lines:
                line = self._lines.popleft()
                self._refused_waiting -= not line[2]
            elif ripe:
                line = self._gathered.pop(ripe[0]).row()
            elif self._unlisted:
                line = (MANY, f"{self._unlisted} further accepted writes", True, "too many to list")
                self._unlisted = 0
            else:
                return
            await self._write(audit, line)

    async def _write(self, audit: Audit, line: Line) -> None:
        try:
            await asyncio.to_thread(audit, *line)
        except Exception:
            log.exception("an audit line could not be written: %s", line)


def _bounded(text: str) -> str:
    """At most ``MAX_CHARS``, and nothing that cannot be written as UTF-8."""
    shown = text if len(text) <= MAX_CHARS else f"{text[:MAX_CHARS]}..."
    return shown.encode("utf-8", "backslashreplace").decode("utf-8")


def _wall_text() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
