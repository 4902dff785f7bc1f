"""A total station as GeoCOM shows it: procedures by number, carried out one at a time, each in its time.

What it measures is the world's tracker. Procedures that it does not have end with code 5.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from math import isfinite

from fakes.geocom.aiming import Aiming
from fakes.geocom.codes import (
    ABORT,
    CANNOT_DECODE,
    DOUBT,
    FATAL,
    IVPARAM,
    NO_FULL_CORRECTION,
    NOT_IMPL,
    OK,
    Answer,
    Parameters,
    RequestCode,
    told,
)
from fakes.geocom.edm import Edm
from fakes.geocom.measuring import Measuring
from fakes.geocom.settings import Settings
from fakes.world.tracker.tracker import Tracker

log = logging.getLogger("cellward.twin.tracker")

EVERY = -1


class Instrument:
    """One station; ``forced`` holds return codes that a fault gives to procedures, or to EVERY one."""

    def __init__(self, tracker: Tracker, now: Callable[[], float], delay_s: float = 0.005) -> None:
        self.tracker, self.now, self.delay_s = tracker, now, delay_s
        self.serial = tracker.truth.serial
        self.forced: dict[int, int] = {}
        self._turn = asyncio.Lock()
        self._running: asyncio.Task[Answer] | None = None
        self.restart()

    def restart(self, serial: str | None = None) -> None:
        """Settings are as at first; with ``serial`` another instrument is in its place."""
        self.serial = serial or self.serial
        self.settings, self.edm = Settings(self.tracker), Edm(self.tracker, self.now)
        aiming = Aiming(self.tracker, self.settings, self.now)
        measuring = Measuring(self.tracker, self.edm, self.settings, aiming, self.now)
        parts = (self.settings, aiming, measuring)
        self._procedures = self._identity()
        for part in parts:
            self._procedures |= part.procedures()

    async def call(self, rpc: int, parameters: tuple[str, ...]) -> Answer:
        """Carry out one procedure."""
        async with self._turn:
            await asyncio.sleep(self.delay_s)
            forced = self.forced.get(rpc, self.forced.get(EVERY, OK))
            if forced not in (OK, NO_FULL_CORRECTION, DOUBT):
                return forced, ()
            procedure = self._procedures.get(rpc)
            if procedure is None:
                return NOT_IMPL, ()
            try:
                numbers = tuple(float(text) for text in parameters)
            except ValueError:
                return CANNOT_DECODE, ()
            if len(numbers) != procedure.takes:
                return CANNOT_DECODE, ()
            if not all(map(isfinite, numbers)):
                return IVPARAM, ()
            code, values = await self._carry_out(procedure, numbers)
            return code or forced, values

    def abort(self) -> None:
        """Stop the procedure that runs."""
        if self._running is not None:
            self._running.cancel()

    async def _carry_out(self, procedure: RequestCode, numbers: Parameters) -> Answer:
        """In a task of its own, for an abort; a defect of the twin is code 4 and a traceback on stderr."""

        async def act() -> Answer:
            result = procedure.act(numbers)
            return await result if isinstance(result, Awaitable) else result

        running = self._running = asyncio.get_running_loop().create_task(act())
        try:
            await asyncio.wait([running])
        finally:
            self._running = None
            running.cancel()
        if running.cancelled():
            return ABORT, ()
        if exc := running.exception():
            log.error("the twin's station failed", exc_info=exc)
            return FATAL, ()
        return running.result()

    def _identity(self) -> dict[int, RequestCode]:
        version = tuple(int(part) for part in self.tracker.truth.version.split("."))
        return {
            0: told(tuple),
            110: told(lambda: (3, 1, 0)),
            2026: told(lambda: 0),  # face one
            5003: told(lambda: int(self.serial)),
            5004: told(lambda: self.tracker.truth.name),
            5034: told(lambda: version),
        }
