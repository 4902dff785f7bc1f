"""The module's own count of time: it falls with a restart, and stands still when old values are repeated."""

from cell.errors import error

LOOK_EVERY_S = 1.0
FROZEN_AFTER_S = 5.0  # several times the unit of a count of seconds


class UptimeWatch:
    """Judges the readings of one connection."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.begin()

    def begin(self) -> None:
        """A new connection: what was read before says nothing of it."""
        self._looked: float | None = None
        self._value: int | None = None
        self._grew = 0.0

    def due(self, now: float) -> bool:
        return self._looked is None or now - self._looked >= LOOK_EVERY_S

    def take(self, now: float, value: int) -> None:
        """One reading. ``MODULE_REBOOTED`` when it fell, ``MODULE_FROZEN`` when it does not grow any more."""
        last, self._looked = self._value, now
        if last is not None and value < last:
            raise error("MODULE_REBOOTED", f"{self._name}: its uptime went from {last} to {value}")
        if last is None or value > last:
            self._value, self._grew = value, now
        elif now - self._grew >= FROZEN_AFTER_S:
            raise error(
                "MODULE_FROZEN", f"{self._name}: its uptime stands at {value} for {now - self._grew:.1f} s"
            )
