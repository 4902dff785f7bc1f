"""How a station turns, searches, aims and follows."""

import asyncio
from collections.abc import Callable
from math import pi

from fakes.geocom.codes import (
    IVPARAM,
    MULTIPLE_TARGETS,
    NO_LOCK,
    NO_TARGET,
    NOT_ENABLED,
    OK,
    Answer,
    Parameters,
    RequestCode,
    told,
)
from fakes.geocom.settings import Settings
from fakes.world.tracker.tracker import MULTIPLE, Tracker

_ATR_RAD = 0.008  # half the view of the target recognition, which no search window undercuts


class Aiming:
    """Procedures that move the instrument; they take the time that the scenario says."""

    def __init__(self, tracker: Tracker, settings: Settings, now: Callable[[], float]) -> None:
        self._tracker, self._settings, self._now = tracker, settings, now

    def procedures(self) -> dict[int, RequestCode]:
        p = RequestCode
        return {
            6021: told(self._locked),
            9013: p(0, self._lock_in),
            9018: p(1, self._set_atr),
            9019: told(lambda: self._settings.atr),
            9020: p(1, self._set_lock),
            9021: told(lambda: self._settings.lock),
            9027: p(5, self._position),
            9037: p(3, lambda a: self.fine_adjust(a[0], a[1])),
        }

    async def fine_adjust(self, width: float = 0.0, height: float = 0.0) -> Answer:
        """Search a window (rad) about the aim for the nearest reflector and aim at it."""
        if not self._settings.atr:
            return NOT_ENABLED, ()
        if not (0.0 <= width <= pi and 0.0 <= height <= pi):
            return IVPARAM, ()
        await asyncio.sleep(self._tracker.truth.search_s)
        status = self._tracker.search(self._now(), max(width / 2, _ATR_RAD), max(height / 2, _ATR_RAD))
        if not status:
            return OK, ()
        return (MULTIPLE_TARGETS if status == MULTIPLE else NO_TARGET), ()

    async def _position(self, a: Parameters) -> Answer:
        """Turn to (hz, v); with the ATR mode (fourth parameter) aim at the reflector there."""
        hz, v = a[0], a[1]
        if not 0.0 <= v <= pi:
            return IVPARAM, ()
        self._tracker.release(self._now())
        await asyncio.sleep(self._tracker.turning_s(self._now(), hz, v))
        self._tracker.turn_to(self._now(), hz, v)
        return await self.fine_adjust() if a[3] else (OK, ())

    def _lock_in(self, a: Parameters) -> Answer:
        if not self._settings.lock:
            return NOT_ENABLED, ()
        self._tracker.advance(self._now())
        if self._tracker.target is None:
            return NO_LOCK, ()
        self._tracker.follow(self._now(), True)
        return OK, ()

    def _locked(self) -> int:
        self._tracker.advance(self._now())
        return int(self._settings.lock and self._tracker.follows and self._tracker.target is not None)

    def _set_atr(self, a: Parameters) -> Answer:
        """Target recognition on or off; either ends following."""
        self._tracker.follow(self._now(), False)
        self._settings.atr, self._settings.lock = bool(a[0]), False
        return OK, ()

    def _set_lock(self, a: Parameters) -> Answer:
        """Following is allowed, and begins with :meth:`_lock_in`; or it ends."""
        if a[0]:
            self._settings.atr = True
        else:
            self._tracker.follow(self._now(), False)
        self._settings.lock = bool(a[0])
        return OK, ()
