"""The heartbeat of a PLC: once seen, its silence is told, and its return."""

import logging
from collections.abc import Callable

from cell.clock import Clock

log = logging.getLogger("cellward.plc")

WATCH_S = 0.05


class PlcHeartbeat:
    """``on_plc(alive)`` is called when the heartbeat is lost and when it returns; ``note(who, what, accepted,
    detail)`` writes the audit."""

    def __init__(
        self,
        clock: Clock,
        limit_s: float,
        note: Callable[[str, str, bool, str], None],
        on_plc: Callable[[bool], None],
    ) -> None:
        self._clock, self._limit_s, self._note, self._on_plc = clock, limit_s, note, on_plc
        self._beat_at: float | None = None
        self.lost = False

    @property
    def heard(self) -> bool:
        """It has been seen since the start."""
        return self._beat_at is not None

    @property
    def alive(self) -> bool:
        """It has been seen and is not lost."""
        return self._beat_at is not None and not self.lost

    def beat(self, client: str) -> None:
        """A sign of life of ``client``."""
        self._beat_at = self._clock.now()
        if self.lost:
            self.lost = False
            log.info("the heartbeat of the PLC is back")
            self._note(client, "heartbeat back", True, "")
            self._tell(True)

    async def watch(self) -> None:
        """Look for silence, for ever."""
        while True:
            await self._clock.sleep(WATCH_S)
            if self._beat_at is None or self.lost or self._clock.now() - self._beat_at <= self._limit_s:
                continue
            self.lost = True
            log.warning("no heartbeat of the PLC for %g s: holding, and refusing new commands", self._limit_s)
            self._note("PLC", "heartbeat lost", False, f"silent for {self._limit_s:g} s")
            self._tell(False)

    def _tell(self, alive: bool) -> None:
        try:
            self._on_plc(alive)
        except Exception:
            log.exception("the loss or return of the PLC's heartbeat could not be handled")
